"""Seams: how much the error jumps from patch to patch of patchwise blendshapes.

Let e = prediction - truth, and |e_i - e_j| its jump along an edge (i, j) of the mesh. Nothing ties the weights of two
neighbouring patches to each other, so there patchwise blendshapes jump, while a smooth error jumps along every edge by
about its gradient times the edge's length. `seam_jump` is the mean over the edges that join two patches (region
`borders`), and over those within one patch that share a vertex with them (region `beside`): the same places, so that a
smooth error moves both alike. `seam_excess` is the difference of the two. All are 0 for the truth and for any constant
error; docs/studies.md gives what smooth errors do to them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking
from retarget.geometry.graph import vertex_adjacency
from retarget.geometry.patches import contiguous_patches
from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class SeamJump(Metric):
    """Jumps of the error in mm across the borders of contiguous METIS patches, those of `plbs`, within a region."""

    region: str
    patch_count: int = 80
    seed: int = 0

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", [self.region], regions.vertices)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        faces, region = (
            np.asarray(array, dtype=np.int64).tobytes()
            for array in (comparison.faces, comparison.regions.vertices[self.region])
        )
        borders, beside = _edges(faces, region, self.patch_count, self.seed)
        error = comparison.retargeted - comparison.truth
        across, along = _mean_jump(error, borders), _mean_jump(error, beside)
        yield Measurement("seam_jump", "borders", "mm", "lower", across)
        yield Measurement("seam_jump", "beside", "mm", "lower", along)
        yield Measurement("seam_excess", "borders", "mm", "zero", across - along)


def _mean_jump(error: FloatArray, edges: IntArray) -> FloatArray:
    """(t,) mm for errors (t, n, 3) mm."""
    return np.array([np.linalg.norm(e[edges[:, 0]] - e[edges[:, 1]], axis=1).mean() for e in error])


@lru_cache(maxsize=4)
def _edges(faces_bytes: bytes, region_bytes: bytes, patch_count: int, seed: int) -> tuple[IntArray, IntArray]:
    """Edges (m, 2) within a region that join two patches, and those that share a vertex with one but join none."""
    faces, region = np.frombuffer(faces_bytes, dtype=np.int64).reshape(-1, 3), np.frombuffer(region_bytes, np.int64)
    return patch_edges(faces, region, contiguous_patches(faces, int(faces.max()) + 1, patch_count, seed))


def patch_edges(faces: IntArray, region: IntArray, patches: tuple[IntArray, ...]) -> tuple[IntArray, IntArray]:
    """(borders, beside): edges (m, 2) with both ends in `region`."""
    label = np.empty(int(faces.max()) + 1, dtype=np.int64)
    for number, patch in enumerate(patches):
        label[patch] = number
    inside = np.zeros(len(label), dtype=bool)
    inside[region] = True
    edges = np.stack(vertex_adjacency(faces, len(label)).nonzero(), axis=1).astype(np.int64)
    edges = edges[(edges[:, 0] < edges[:, 1]) & inside[edges].all(axis=1)]
    joins = label[edges[:, 0]] != label[edges[:, 1]]
    met = np.zeros(len(label), dtype=bool)
    met[edges[joins]] = True
    return edges[joins], edges[~joins & met[edges].any(axis=1)]
