"""What a metric gets and what it answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass

from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class Disturbed:
    """The first k frames once more, from a source with noise."""

    noise: FloatArray  # (k, n, 3) mm, added to the source's frames
    retargeted: FloatArray  # (k, n, 3) mm


@dataclass(frozen=True)
class Comparison:
    """One cell's answer beside the truth. No prediction is aligned before a metric."""

    retargeted: FloatArray  # (t, n, 3) mm
    truth: FloatArray  # (t, n, 3) mm
    source: FloatArray  # (t, n, 3) mm, the source's frames
    source_neutral: FloatArray  # (n, 3) mm
    target_neutral: FloatArray  # (n, 3) mm
    faces: IntArray  # (f, 3)
    regions: Regions
    ordered: bool = False  # the frames are an animation, one after the other
    disturbed: Disturbed | None = None  # where a study asks for it


@dataclass(frozen=True)
class Measurement:
    """One number per frame."""

    metric: str
    region: str
    unit: str
    direction: str  # "lower", "higher" or "zero": what is better
    values: FloatArray  # (t,)


class Metric(ABC):
    """A frozen dataclass of settings that Hydra makes from ``conf/metric/*.yaml``."""

    def unsupported(self, regions: Regions) -> str | None:
        """The reason why this metric cannot measure a topology, or None: a study then leaves it out and says so."""
        return None

    @abstractmethod
    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        """Measure every frame."""


def check_ordered(name: str, comparison: Comparison) -> None:
    """Raises InvalidInput where a metric of time meets single expressions."""
    if not comparison.ordered:
        raise InvalidInput(
            f"metric {name}: expected frames of an animation, but this study tests single expressions. "
            "Choose study=temporal, or another metric."
        )


def lacking(kind: str, names: Iterable[str], known: Container[str]) -> str | None:
    """The reason of a metric that needs parts of a topology (a field of `Regions`) which it does not name."""
    missing = [name for name in names if name not in known]
    return f"the regions of this dataset name no {kind} {', '.join(missing)}" if missing else None


def region_vertices(regions: Regions, names: Sequence[str]) -> Iterator[tuple[str, IntArray]]:
    """The named vertex sets; raises InvalidInput for one that this topology does not have."""
    for name in names:
        if name not in regions.vertices:
            raise InvalidInput(
                f"metric region '{name}': this dataset has {', '.join(sorted(regions.vertices))}. "
                "Choose among these with metric.<name>.regions=[...]."
            )
        yield name, regions.vertices[name]
