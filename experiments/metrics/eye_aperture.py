"""How far an eye is open, beside the truth: what the eye characteristics of AnaConDaR (eq. 15) are there for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking
from retarget.geometry.triangles import areas
from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class EyeAperture(Metric):
    """|A(prediction) - A(truth)| / A(neutral), where A is the area of the patch between the lids; without unit.

    Per opening under its own name, and their mean as the region `eyes`. Areas are unsigned: lids that cross by as much
    as they were open count as open, in prediction and truth alike (docs/regions.md).
    """

    openings: Sequence[str]  # of `Regions.patches`

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("patches", self.openings, regions.patches)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        errors = []
        for name in self.openings:
            patch = comparison.regions.patches[name]
            neutral = _area(comparison.target_neutral[None], patch)
            errors.append(np.abs(_area(comparison.retargeted, patch) - _area(comparison.truth, patch)) / neutral)
            yield Measurement("eye_aperture", name, "1", "lower", errors[-1])
        yield Measurement("eye_aperture", "eyes", "1", "lower", np.mean(errors, axis=0))


def _area(frames: FloatArray, patch: IntArray) -> FloatArray:
    """(t,) mm^2 for frames (t, n, 3) mm."""
    return np.array([areas(frame, patch).sum() for frame in frames])
