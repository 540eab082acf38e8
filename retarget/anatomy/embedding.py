"""The skin in the tets: skin = P vertices + residual, whatever the resolution of either."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from retarget.anatomy.boundary import boundary_faces
from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray

LARGEST_OFFSET = 4.0  # mm from a skin vertex to the tets' boundary; more means that they are of another surface
LARGEST_WEIGHT = 1.5  # by magnitude, of a vertex extrapolated out of its tet
_CANDIDATES = 24  # boundary triangles looked at for each skin vertex


def embed(skin: FloatArray, faces: IntArray, vertices: FloatArray, tets: IntArray) -> sp.csr_array:
    """P (n, m), rows sum to one: the skin (n, 3) mm with triangles (f, 3) from tet vertices (m, 3) mm.

    A skin vertex belongs to the tet behind the closest triangle of the tets' boundary that faces as the skin does
    there, so that nothing is embedded across the mouth or an eye. Its weights are barycentric coordinates, slightly
    extrapolated where the skin lies outside; where they would exceed `LARGEST_WEIGHT`, as in a sliver, the tet nearby
    that extrapolates least takes its place, or at last the closest point of the triangle, which leaves a residual.
    Raises InvalidInput for skin farther than `LARGEST_OFFSET` from the boundary.
    """
    triangles, owner = boundary_faces(tets)
    corners = vertices[triangles]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = _vertex_normals(skin, faces)
    _, near = cKDTree(corners.mean(axis=1)).query(skin, k=min(_CANDIDATES, len(triangles)))
    near = near.reshape(len(skin), -1)
    flat = near.ravel()
    local = _closest_on_triangle(np.repeat(skin, near.shape[1], axis=0), corners[flat])
    closest = np.einsum("ij,ijk->ik", local, corners[flat]).reshape(*near.shape, 3)
    distance = np.linalg.norm(closest - skin[:, None], axis=2)
    facing: NDArray[np.bool_] = np.einsum("ijk,ik->ij", outward[near], normals) > 0
    best = np.argmin(np.where(facing, distance, distance + 1e3), axis=1)
    rows = np.arange(len(skin))
    if not (distance[rows, best] <= LARGEST_OFFSET).all():
        offset = distance[rows, best]
        worst = int(np.argmax(offset))
        raise InvalidInput(
            f"skin: expected it within {LARGEST_OFFSET:g} mm of the tets' boundary, got {offset[worst]:.1f} mm at "
            f"vertex {worst}; the tets are of another surface."
        )
    tet = tets[owner[near[rows, best]]]
    weights = _barycentric(skin, vertices[tet])
    wild = np.flatnonzero(np.abs(weights).max(axis=1) > LARGEST_WEIGHT)
    for row in wild:
        around = tets[owner[near[row, facing[row]]]]
        options = _barycentric(np.repeat(skin[row : row + 1], len(around), axis=0), vertices[around])
        least = int(np.argmin(np.abs(options).max(axis=1)))
        if np.abs(options[least]).max() <= LARGEST_WEIGHT:
            tet[row], weights[row] = around[least], options[least]
        else:
            on_triangle = local.reshape(*near.shape, 3)[row, best[row]]
            by_vertex = dict(zip(triangles[near[row, best[row]]].tolist(), on_triangle.tolist(), strict=True))
            weights[row] = [by_vertex.get(vertex, 0.0) for vertex in tet[row].tolist()]
    return sp.csr_array((weights.ravel(), (np.repeat(rows, 4), tet.ravel())), shape=(len(skin), len(vertices)))


def _vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(n, 3) sums of the normals of the triangles at each vertex, weighted by area."""
    face_normals = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    return normals


def _barycentric(points: FloatArray, corners: FloatArray) -> FloatArray:
    """(n, 4) coordinates of points (n, 3) in tets (n, 4, 3)."""
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    tail = np.linalg.solve(edges, (points - corners[:, 0])[:, :, None])[:, :, 0]
    return np.column_stack([1 - tail.sum(axis=1), tail])


def _closest_on_triangle(points: FloatArray, corners: FloatArray) -> FloatArray:
    """(n, 3) barycentric coordinates of the point of each triangle (n, 3, 3) that is closest to points (n, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    aa, bb, cross = (np.einsum("ij,ij->i", u, v) for u, v in ((ab, ab), (ac, ac), (ab, ac)))
    pa, pb = np.einsum("ij,ij->i", ap, ab), np.einsum("ij,ij->i", ap, ac)
    det = np.maximum(aa * bb - cross**2, 1e-300)
    v, w = (bb * pa - cross * pb) / det, (aa * pb - cross * pa) / det
    inside = np.column_stack([1 - v - w, v, w])
    edges = [np.zeros_like(inside) for _ in range(3)]
    best, found = np.full(len(points), np.inf), inside.copy()
    for edge, (i, j) in zip(edges, ((0, 1), (1, 2), (2, 0)), strict=True):
        along = corners[:, j] - corners[:, i]
        length = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
        s = np.clip(np.einsum("ij,ij->i", points - corners[:, i], along) / length, 0.0, 1.0)
        edge[:, i], edge[:, j] = 1 - s, s
        gap = corners[:, i] + s[:, None] * along - points
        squared = np.einsum("ij,ij->i", gap, gap)
        found = np.where((squared < best)[:, None], edge, found)
        best = np.minimum(best, squared)
    within = np.all(inside >= 0, axis=1, keepdims=True)
    result: FloatArray = np.where(within, inside, found)
    return result
