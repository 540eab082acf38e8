"""The surface that skin slides over: the smoothed neutral, which follows the skull at the depth of the tissue.

An implicit moving-least-squares function of smoothed skin points and normals; a point of the skin keeps its value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from retarget.geometry.oriented import vertex_normals
from retarget.types import FloatArray, IntArray
from synth_data.personal.shares import Skin

CELL = 6.0  # mm, of the grid in which skin points are averaged
SMOOTH = 7.0  # mm, of the surface
NEIGHBOURS, WIDTH = 28, 8.0  # points that a value depends on; mm of their Gaussian weight


@dataclass(frozen=True)
class Sliding:
    """The guide surface as oriented points."""

    tree: cKDTree
    points: FloatArray  # (p, 3) mm
    normals: FloatArray  # (p, 3)
    areas: FloatArray  # (p,) mm^2

    def __call__(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Height (m,) mm over the surface and unit normals (m, 3) at points (m, 3) mm."""
        distance, near = self.tree.query(at, NEIGHBOURS)
        reach = np.maximum(distance[:, -1:], 1e-9)
        taper = (1 - np.minimum(distance / reach, 1) ** 2) ** 2  # a neighbour enters and leaves without a jump
        nearest = distance[:, :1]
        weight = self.areas[near] * taper * np.exp(-0.5 * (distance**2 - nearest**2) / WIDTH**2)
        weight /= weight.sum(axis=1, keepdims=True)
        normal = np.einsum("mk,mkj->mj", weight, self.normals[near])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        height = np.einsum("mk,mkj,mkj->m", weight, self.normals[near], at[:, None] - self.points[near])
        return height, normal


def sliding_surface(vertices: FloatArray, faces: IntArray, skin: Skin, outside: IntArray) -> Sliding:
    """The guide of a neutral (n, 3) mm from the vertices named by `outside`, averaged in cells of `CELL` mm."""
    smooth = skin.blurred(vertices, SMOOTH)
    normals = vertex_normals(smooth, faces)
    cells = np.floor(smooth[outside] / CELL).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    mass = skin.mass[outside]
    areas: FloatArray = np.bincount(cell, mass).astype(np.float64)

    def mean(values: FloatArray) -> FloatArray:
        return np.stack([np.bincount(cell, mass * column) / areas for column in values[outside].T], axis=1)

    points, directions = mean(smooth), mean(normals)
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
    return Sliding(cKDTree(points), points, directions, areas)
