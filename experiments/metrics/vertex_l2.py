"""Vertex error: the paper's metric (section 4.4, Fig. 10), by region."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, region_vertices
from retarget.check import InvalidInput
from retarget.types import FloatArray

STATISTICS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "mean": lambda d: d.mean(axis=1),
    "p95": lambda d: np.percentile(d, 95, axis=1),
    "max": lambda d: d.max(axis=1),
}


@dataclass(frozen=True)
class VertexL2(Metric):
    """Euclidean distance of each vertex to its true position, in mm, reduced over a region per frame."""

    statistics: Sequence[str]
    regions: Sequence[str]

    def __post_init__(self) -> None:
        for name in self.statistics:
            if name not in STATISTICS:
                raise InvalidInput(
                    f"metric.vertex_l2.statistics: expected some of {', '.join(STATISTICS)}, got '{name}'."
                )

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        distance = np.linalg.norm(comparison.retargeted - comparison.truth, axis=2)
        for region, vertices in region_vertices(comparison.regions, self.regions):
            for name in self.statistics:
                values = STATISTICS[name](distance[:, vertices])
                yield Measurement(f"vertex_l2_{name}", region, "mm", "lower", values)
