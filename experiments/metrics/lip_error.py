"""Lip error: the worst vertex of the lips in each frame, and the mean distance on the lip contour."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking
from retarget.types import Regions


@dataclass(frozen=True)
class LipError(Metric):
    """Distance to the truth in mm: its maximum over the lips, the lip vertex error of speech animation (Richard et al.
    2021), and its mean over the vermilion border, which AnaConDaR holds to the source's (eqs 16, 17).
    """

    lips: str  # of `Regions.vertices`
    contour: str  # of `Regions.loops`

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", [self.lips], regions.vertices) or lacking("loops", [self.contour], regions.loops)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        distance = np.linalg.norm(comparison.retargeted - comparison.truth, axis=2)
        lips, contour = comparison.regions.vertices[self.lips], comparison.regions.loops[self.contour]
        yield Measurement("lip_error_max", self.lips, "mm", "lower", distance[:, lips].max(axis=1))
        yield Measurement("lip_error_mean", self.contour, "mm", "lower", distance[:, contour].mean(axis=1))
