"""Tissue between two spheres, small enough to be meshed in a test."""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh

from retarget.anatomy.boundary import boundary_faces
from retarget.anatomy.mesher import tetrahedralise
from retarget.anatomy.tissue import Tissue
from retarget.types import FloatArray, IntArray

OUTER, INNER = 60.0, 40.0  # mm


def sphere(radius: float, subdivisions: int = 3) -> tuple[FloatArray, IntArray]:
    """An outward icosphere."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.array(ball.vertices), np.array(ball.faces, dtype=np.int64)


@cache
def shell() -> Tissue:
    """Tets between the spheres, made by the mesher."""
    (skin, faces), (bone, inner) = sphere(OUTER), sphere(INNER)
    box = 100.0 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    cells = np.array([[0, 1, 2, 4], [1, 2, 3, 7], [1, 4, 5, 7], [2, 4, 6, 7], [1, 2, 4, 7]])
    vertices, tets = tetrahedralise(
        np.vstack([skin, bone]),
        np.vstack([faces, inner[:, ::-1] + len(skin)]),
        (box, cells, np.full(8, 12.0)),
        envelope=0.5,
        quality=10.0,
    )
    radius = np.linalg.norm(vertices, axis=1)
    triangles, _ = boundary_faces(tets)
    inner_side = triangles[radius[triangles].mean(axis=1) < 0.5 * (OUTER + INNER)][:, ::-1]
    return Tissue(vertices, tets, inner_side)
