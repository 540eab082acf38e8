"""Kinds of ground truth: how an identity performs the expressions. A new kind is one entry of `TRUTHS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from retarget.types import FloatArray, Regions
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import Identity
from synth_data.makehuman.rig import personal_rig
from synth_data.makehuman.targets import Targets

Performer = Callable[[FloatArray], FloatArray]  # (t, 51) weights of `SKIN_NAMES` to (t, n, 3) mm on the base topology


@dataclass(frozen=True)
class Truth:
    """A kind of ground truth."""

    make: Callable[[Identity, BaseHead, Targets, Regions], Performer]
    favours: str  # what it resembles and cannot show, for the report


@dataclass(frozen=True)
class Blendshapes:
    """neutral + sum_j w_j delta_j."""

    neutral: FloatArray  # (n, 3) mm
    deltas: FloatArray  # (51, n, 3) mm

    def __call__(self, weights: FloatArray) -> FloatArray:
        return self.neutral + np.tensordot(weights, self.deltas, axes=1)


def _personal_blendshapes(identity: Identity, head: BaseHead, targets: Targets, regions: Regions) -> Performer:
    return Blendshapes(identity.vertices, personal_rig(identity, head, targets, regions))


TRUTHS: Mapping[str, Truth] = {
    "personal_blendshapes": Truth(
        _personal_blendshapes,
        "The ground truth is synthetic: personal ARKit blendshapes blended linearly. LBS becomes exact as the examples "
        "span the 51 units, so this truth favours linear methods with many examples. The personal units are pointwise "
        "transforms of one shared displacement field and move the same vertices for everybody, so it also favours "
        "delta transfer over deformation transfer, and thereby penalises the residual controls. It was made without "
        "any real expression and shows nothing about contact, skin sliding or other non-linear motion.",
    ),
}
