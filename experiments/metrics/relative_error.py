"""Relative error: how much of the motion is missed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking, region_vertices
from retarget.types import Regions


@dataclass(frozen=True)
class RelativeError(Metric):
    """Mean distance to the truth over the mean distance of the truth from its neutral, by region, in %.

    100 is what a face that does not move gets. A region that moves by less than `least_mm` is taken to move by that
    much, so that an expression which leaves it still does not decide the mean. It cannot see where within the region
    the error lies.
    """

    regions: Sequence[str]
    least_mm: float = 0.1

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", self.regions, regions.vertices)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        distance = np.linalg.norm(comparison.retargeted - comparison.truth, axis=2)
        motion = np.linalg.norm(comparison.truth - comparison.target_neutral, axis=2)
        for region, vertices in region_vertices(comparison.regions, self.regions):
            moved = np.maximum(motion[:, vertices].mean(axis=1), self.least_mm)
            yield Measurement("relative_error", region, "%", "lower", 100 * distance[:, vertices].mean(axis=1) / moved)
