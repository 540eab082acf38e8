"""How far skin is stretched or squeezed against the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking, region_vertices
from experiments.metrics.topology import inner_edges
from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class EdgeDeviation(Metric):
    """Mean over edges of | |e| - |e_true| | / |e_neutral|, by region, in %.

    It sees seams, folds and texture that swims; it sees no rigid motion, and no bending that keeps lengths.
    """

    regions: Sequence[str]

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", self.regions, regions.vertices)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        for region, vertices in region_vertices(comparison.regions, self.regions):
            edges = inner_edges(comparison.faces, vertices)
            rest = _lengths(comparison.target_neutral[None], edges)[0]
            wrong = np.abs(_lengths(comparison.retargeted, edges) - _lengths(comparison.truth, edges))
            yield Measurement("edge_deviation", region, "%", "lower", 100 * (wrong / rest).mean(axis=1))


def _lengths(frames: FloatArray, edges: IntArray) -> FloatArray:
    """(t, m) mm of frames (t, n, 3) mm and edges (m, 2)."""
    along = frames[:, edges[:, 0]] - frames[:, edges[:, 1]]
    lengths: FloatArray = np.sqrt(np.einsum("tei,tei->te", along, along))
    return lengths
