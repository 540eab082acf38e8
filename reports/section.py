"""Plane sections through a mesh."""

from __future__ import annotations

from retarget.types import FloatArray, IntArray


def section(vertices: FloatArray, faces: IntArray, x: float) -> FloatArray:
    """(s, 2, 2) mm: the segments, as (z, y), in which the triangles meet the plane of points with this x.

    A plane through a vertex is taken to pass it on the left.
    """
    side = vertices[:, 0] > x
    cut = faces[side[faces].any(axis=1) & ~side[faces].all(axis=1)]
    edges = cut[:, [[0, 1], [1, 2], [2, 0]]]  # (s, 3, 2)
    crossed = side[edges[..., 0]] != side[edges[..., 1]]  # two of three
    ends = edges[crossed].reshape(-1, 2, 2)
    a, b = vertices[ends[..., 0]], vertices[ends[..., 1]]
    share = (x - a[..., 0]) / (b[..., 0] - a[..., 0])
    points: FloatArray = a + share[..., None] * (b - a)
    return points[..., [2, 1]]
