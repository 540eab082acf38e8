"""`study.correspondence`: which source expressions a method is told to correspond to the target examples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from retarget.suggest import choose
from retarget.types import FloatArray


@dataclass(frozen=True)
class Known:
    """What the study knows of the source when it fills in the source examples."""

    source_examples: FloatArray  # (k, n, 3) mm: the same expressions, performed by the source


def given(known: Known) -> FloatArray:
    """The source performs the same expressions as the examples (paper, section 3.2.1)."""
    return known.source_examples


CORRESPONDENCES: dict[str, Callable[[Known], FloatArray]] = {"given": given}


def correspondence(name: str) -> Callable[[Known], FloatArray]:
    """Raises InvalidInput for an unknown name."""
    return CORRESPONDENCES[choose("study.correspondence", name, CORRESPONDENCES)]
