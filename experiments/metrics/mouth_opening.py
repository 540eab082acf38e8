"""How far the mouth is open, beside the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking
from retarget.types import FloatArray, Regions


@dataclass(frozen=True)
class MouthOpening(Metric):
    """|A(prediction) - A(truth)| / C(neutral); without unit.

    A is the area within the loop where the lips meet, seen along the normal of the lip contour at rest, and negative
    where the lips have passed each other; C is the area within the lip contour of the target's neutral.
    The opening at rest, which `eye_aperture` divides by, is almost nothing for a mouth.
    It cannot see lips that shift sideways or forward, nor two errors along the loop that cancel.
    """

    opening: str  # of `Regions.loops`
    contour: str  # of `Regions.loops`

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("loops", [self.opening, self.contour], regions.loops)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        neutral, loops = comparison.target_neutral, comparison.regions.loops
        opening, contour = loops[self.opening], loops[self.contour]
        outer = vector_area(neutral[contour])
        size = np.linalg.norm(outer)
        normal = outer / size  # its sign does not matter: the two loops may run in opposite senses
        found, wanted = (vector_area(frames[:, opening]) for frames in (comparison.retargeted, comparison.truth))
        wrong = np.abs((found - wanted) @ normal)
        yield Measurement("mouth_opening", "mouth", "1", "lower", wrong / size)


def vector_area(loop: FloatArray) -> FloatArray:
    """(..., 3) mm^2 of closed loops (..., m, 3) mm: half the sum of p_i x p_i+1, whatever spans the loop."""
    area: FloatArray = np.cross(loop, np.roll(loop, -1, axis=-2)).sum(axis=-2) / 2
    return area
