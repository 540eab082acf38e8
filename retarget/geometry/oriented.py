"""Closest points between surfaces that tell the two sides of a gap apart, such as lips that touch.

A surface point is its position and its normal times `REACH`: what lies as near but faces the other way is far.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from retarget.geometry.triangles import edges
from retarget.types import FloatArray, IntArray

REACH = 10.0  # mm that a point may rather be away than face the other way by 60 degrees


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(n, 3) unit normals, weighted by area; zero for a vertex without a triangle."""
    normals = np.zeros_like(vertices)
    twice_area = np.cross(*edges(vertices, faces))
    for corner in faces.T:
        for axis in range(3):
            normals[:, axis] += np.bincount(corner, twice_area[:, axis], len(vertices))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.maximum(length, 1e-12)


class OrientedSurface:
    """Samples of the triangles (f, 3) on vertices (n, 3) mm, at most about `spacing` mm apart, for many queries."""

    def __init__(self, vertices: FloatArray, faces: IntArray, spacing: float = 1.0, normals: FloatArray | None = None):
        longest = np.linalg.norm(vertices[faces] - np.roll(vertices[faces], 1, axis=1), axis=2).max(axis=1)
        steps = np.clip(np.ceil(longest / spacing).astype(int), 1, 12)
        triangles, weights = [], []
        for step in np.unique(steps):
            i, j = np.nonzero(np.add.outer(np.arange(step + 1), np.arange(step + 1)) <= step)
            inside = np.column_stack([i, j, step - i - j]) / step
            mine = np.flatnonzero(steps == step)
            triangles.append(np.repeat(mine, len(inside)))
            weights.append(np.tile(inside, (len(mine), 1)))
        self.triangles = np.concatenate(triangles)  # (s,) of each sample
        self.weights = np.concatenate(weights)  # (s, 3) barycentric
        self.corners = faces[self.triangles]  # (s, 3)
        normals = vertex_normals(vertices, faces) if normals is None else normals
        self.positions, self.normals = self._at(vertices), self._at(normals)
        self._tree = cKDTree(oriented(self.positions, self.normals))

    def closest(self, points: FloatArray, normals: FloatArray) -> IntArray:
        """(m,) the sample that belongs to each of points (m, 3) mm with unit normals (m, 3)."""
        found: IntArray = self._tree.query(oriented(points, normals))[1]
        return found

    def _at(self, values: FloatArray) -> FloatArray:
        found: FloatArray = np.einsum("sc,scd->sd", self.weights, values[self.corners])
        return found


def oriented(points: FloatArray, normals: FloatArray) -> FloatArray:
    """(m, 6) points (m, 3) mm with their unit normals, in which distance tells sides apart."""
    return np.hstack([points, REACH * normals])
