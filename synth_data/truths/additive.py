"""Shared displacements for everybody: neutral + sum_j w_j delta_j with the deltas of the generic rig.

Delta transfer has no error here by construction, so this kind is a sanity row and no evidence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from synth_data.cache import ArrayCache
from synth_data.dataset import Progress
from synth_data.truth import Blendshapes, Casting, GenericRig, Truth


@dataclass(frozen=True)
class Additive(Truth):
    """The generic rig on every neutral."""

    favours: ClassVar[str] = (
        "The ground truth is additive: every person adds the same displacements to the neutral. Delta transfer is "
        "exact by construction, and linear methods are with many examples. A sanity check, from which nothing follows."
    )

    def prepare(self, generic: GenericRig, cache: ArrayCache, progress: Progress) -> Casting:
        return lambda person: Blendshapes(person.neutral, generic.deltas)


TRUTH = Additive()
