"""Skin that passes through itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking
from retarget.anatomy.crossings import self_intersections
from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class SelfIntersections(Metric):
    """Number of pairs of triangles that pass through each other and did not in the target's neutral.

    Counted are pairs with at least one triangle within the region, the visible skin. The number grows with the
    resolution of the mesh, and says nothing about depth: `lip_depth` does, of the lips. No truth enters: linear truths
    cross as well (the reference row `truth` says how much).
    """

    region: str

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", [self.region], regions.vertices)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        seen = np.zeros(len(comparison.target_neutral), dtype=bool)
        seen[comparison.regions.vertices[self.region]] = True
        visible = np.asarray(seen[comparison.faces].all(axis=1))
        resting = _crossings(comparison.target_neutral, comparison.faces, visible)
        counts = [
            len(np.setdiff1d(_crossings(frame, comparison.faces, visible), resting, assume_unique=True))
            for frame in comparison.retargeted
        ]
        yield Measurement("self_intersections", self.region, "pairs", "lower", np.array(counts, dtype=np.float64))


def _crossings(vertices: FloatArray, faces: IntArray, visible: NDArray[np.bool_]) -> IntArray:
    """(p,) one number for each pair of triangles, whichever of them passes through the other."""
    pairs = np.sort(self_intersections(vertices, faces), axis=1)
    pairs = pairs[visible[pairs].any(axis=1)]
    return np.unique(pairs[:, 0] * len(faces) + pairs[:, 1])
