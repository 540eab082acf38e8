"""What metrics need of a topology, found once: the same faces and regions come with every cell of a study."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import TypeVar

import numpy as np

from retarget.geometry.graph import components, half_edges, vertex_adjacency
from retarget.types import IntArray

T = TypeVar("T")


def _kept(function: Callable[[IntArray, IntArray], T]) -> Callable[[IntArray, IntArray], T]:
    """Remember the answers for faces (f, 3) and vertices (m,), by content."""

    @lru_cache(maxsize=16)
    def of(faces: bytes, vertices: bytes) -> T:
        return function(np.frombuffer(faces, np.int64).reshape(-1, 3), np.frombuffer(vertices, np.int64))

    @wraps(function)
    def remembered(faces: IntArray, vertices: IntArray) -> T:
        return of(*(np.ascontiguousarray(array, dtype=np.int64).tobytes() for array in (faces, vertices)))

    return remembered


@_kept
def inner_faces(faces: IntArray, vertices: IntArray) -> IntArray:
    """(g, 3) the triangles with all corners in a set of vertices (m,)."""
    inside = np.zeros(int(faces.max()) + 1, dtype=bool)
    inside[vertices] = True
    return faces[inside[faces].all(axis=1)]


@_kept
def inner_edges(faces: IntArray, vertices: IntArray) -> IntArray:
    """(e, 2) the edges of these triangles, each once."""
    edges, count = np.sort(half_edges(inner_faces(faces, vertices)), axis=1), int(faces.max()) + 1
    keys = np.unique(edges[:, 0] * count + edges[:, 1])
    return np.stack([keys // count, keys % count], axis=1)


@_kept
def open_rims(faces: IntArray, vertices: IntArray) -> tuple[IntArray, ...]:
    """Half-edges (k, 2) of the triangles within a set of vertices that have no opposite, by connected border."""
    edges, count = half_edges(inner_faces(faces, vertices)), int(faces.max()) + 1
    alone = edges[~np.isin(edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0])]
    if not len(alone):
        return ()
    joined = vertex_adjacency(np.c_[alone, alone[:, :1]], count)
    joined.setdiag(0)
    joined.eliminate_zeros()
    parts = components(joined)
    return tuple(alone[np.isin(alone[:, 0], part)] for part in parts if len(part) > 1)
