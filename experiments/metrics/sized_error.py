"""Sized error: how large an error is for the part of the face that has it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking, region_vertices
from retarget.geometry.triangles import areas
from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class SizedError(Metric):
    """Mean distance to the truth over the region's size, in %: the square root of its area on the target's neutral.

    Half a millimetre is little for a cheek and much for a lip. It compares regions, and people of different size; of
    one region of one person it says what `vertex_l2_mean` says.
    """

    regions: Sequence[str]

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", self.regions, regions.vertices)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        distance = np.linalg.norm(comparison.retargeted - comparison.truth, axis=2)
        area = vertex_areas(comparison.target_neutral, comparison.faces)
        for region, vertices in region_vertices(comparison.regions, self.regions):
            size = np.sqrt(area[vertices].sum())
            yield Measurement("sized_error", region, "%", "lower", 100 * distance[:, vertices].mean(axis=1) / size)


def vertex_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(n,) mm^2: a third of the triangles (f, 3) at each vertex (n, 3) mm."""
    third = np.repeat(areas(vertices, faces) / 3, 3)
    lumped: FloatArray = np.bincount(faces.ravel(), third, len(vertices)).astype(np.float64)
    return lumped
