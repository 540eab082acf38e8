"""How far the surface is tilted against the true one: what shading shows of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking, region_vertices
from experiments.metrics.topology import inner_faces
from retarget.geometry.triangles import edges
from retarget.types import FloatArray, IntArray, Regions

TINY = 1e-12  # mm^2


@dataclass(frozen=True)
class NormalDeviation(Metric):
    """Mean angle in degrees between the normals of triangles and the true ones, by region, weighted by the true area.

    It sees wrinkles and noise that hardly move a vertex, and no offset at all. A triangle that has collapsed counts
    as tilted by a right angle.
    """

    regions: Sequence[str]

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", self.regions, regions.vertices)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        for region, vertices in region_vertices(comparison.regions, self.regions):
            faces = inner_faces(comparison.faces, vertices)
            both = zip(comparison.retargeted, comparison.truth, strict=True)
            values = np.array([_tilt(found, true, faces) for found, true in both])
            yield Measurement("normal_deviation", region, "deg", "lower", values)


def _tilt(found: FloatArray, true: FloatArray, faces: IntArray) -> float:
    a, b = (np.cross(*edges(vertices, faces)) for vertices in (found, true))
    area = _length(b)
    a, b = a / np.maximum(_length(a), TINY)[:, None], b / np.maximum(area, TINY)[:, None]
    angle = 2 * np.arctan2(_length(a - b), _length(a + b))  # exact near 0 (Kahan 2006, section 12)
    return float(np.degrees(angle @ area / max(area.sum(), TINY)))


def _length(vectors: FloatArray) -> FloatArray:
    lengths: FloatArray = np.sqrt(np.einsum("fi,fi->f", vectors, vectors))
    return lengths
