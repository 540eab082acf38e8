"""Where a triangle surface passes through itself."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.geometry.graph import half_edges
from retarget.types import FloatArray, IntArray

_FLAT = 1e-9  # mm^3: less is rounding, as where triangles lie in one plane
_CELL = 3.0  # of the edges' median length: side of the cells by which triangles are looked up
_LARGEST = 128  # cells along an axis


def self_intersections(vertices: FloatArray, faces: IntArray) -> IntArray:
    """(p, 2) pairs of triangles, an edge of one of which passes through the other; neighbours are left out."""
    corners = np.sort(half_edges(faces), axis=1)
    keys = corners[:, 0] * len(vertices) + corners[:, 1]
    _, first = np.unique(keys, return_index=True)
    edges, owner = np.ascontiguousarray(corners[first]), first % len(faces)
    x, triangles = np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.int64)
    low = x.min(axis=0)
    extent = x.max(axis=0) - low
    length = float(np.median(np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)))
    cell = max(_CELL * length, float(extent.max()) / _LARGEST, 1e-9)
    found = _crossings(x, edges, owner, triangles, low, cell, (extent / cell).astype(np.int64) + 1)
    return np.unique(found, axis=0)


@njit(cache=True, nogil=True)
def _crossings(x, edges, owner, faces, low, cell, counts):  # type: ignore[no-untyped-def]
    """(p, 2) owner of the edge and triangle, a pair as often as cells hold both."""
    size = counts[0] * counts[1] * counts[2]
    start = np.zeros(size + 1, np.int64)
    first, last = np.empty((len(faces), 3), np.int64), np.empty((len(faces), 3), np.int64)
    for f in range(len(faces)):
        for i in range(3):
            a, b, c = x[faces[f, 0], i], x[faces[f, 1], i], x[faces[f, 2], i]
            first[f, i] = int((min(a, b, c) - low[i]) / cell)
            last[f, i] = int((max(a, b, c) - low[i]) / cell)
        for u in range(first[f, 0], last[f, 0] + 1):
            for v in range(first[f, 1], last[f, 1] + 1):
                for w in range(first[f, 2], last[f, 2] + 1):
                    start[(u * counts[1] + v) * counts[2] + w + 1] += 1
    for k in range(size):
        start[k + 1] += start[k]
    held, filled = np.empty(start[size], np.int64), start[:-1].copy()
    for f in range(len(faces)):
        for u in range(first[f, 0], last[f, 0] + 1):
            for v in range(first[f, 1], last[f, 1] + 1):
                for w in range(first[f, 2], last[f, 2] + 1):
                    k = (u * counts[1] + v) * counts[2] + w
                    held[filled[k]] = f
                    filled[k] += 1
    found = [(np.int64(0), np.int64(0)) for _ in range(0)]
    here, there = np.empty(3, np.int64), np.empty(3, np.int64)
    for e in range(len(edges)):
        p, q = edges[e, 0], edges[e, 1]
        for i in range(3):
            here[i] = int((min(x[p, i], x[q, i]) - low[i]) / cell)
            there[i] = int((max(x[p, i], x[q, i]) - low[i]) / cell)
        for u in range(here[0], there[0] + 1):
            for v in range(here[1], there[1] + 1):
                for w in range(here[2], there[2] + 1):
                    k = (u * counts[1] + v) * counts[2] + w
                    for f in held[start[k] : start[k + 1]]:
                        if _passes(x, p, q, faces[f, 0], faces[f, 1], faces[f, 2]):
                            found.append((owner[e], f))
    pairs = np.empty((len(found), 2), np.int64)
    for k in range(len(found)):
        pairs[k, 0], pairs[k, 1] = found[k]
    return pairs


@njit(cache=True, nogil=True)
def _passes(x, p, q, a, b, c):  # type: ignore[no-untyped-def]
    """Whether the segment pq passes through the triangle abc without sharing a vertex."""
    if p in (a, b, c) or q in (a, b, c):
        return False
    for i in range(3):
        if min(x[p, i], x[q, i]) > max(x[a, i], x[b, i], x[c, i]) or max(x[p, i], x[q, i]) < min(
            x[a, i], x[b, i], x[c, i]
        ):
            return False
    if _volume(x, a, b, c, p) * _volume(x, a, b, c, q) >= 0:
        return False
    one, two, three = _volume(x, p, q, a, b), _volume(x, p, q, b, c), _volume(x, p, q, c, a)
    return (one > 0 and two > 0 and three > 0) or (one < 0 and two < 0 and three < 0)


@njit(cache=True, nogil=True)
def _volume(x, u, v, w, o):  # type: ignore[no-untyped-def]
    """Six times the signed volume of a tetrahedron, 0 where it is flat."""
    u0, u1, u2 = x[u, 0] - x[o, 0], x[u, 1] - x[o, 1], x[u, 2] - x[o, 2]
    v0, v1, v2 = x[v, 0] - x[o, 0], x[v, 1] - x[o, 1], x[v, 2] - x[o, 2]
    w0, w1, w2 = x[w, 0] - x[o, 0], x[w, 1] - x[o, 1], x[w, 2] - x[o, 2]
    signed = u0 * (v1 * w2 - v2 * w1) + u1 * (v2 * w0 - v0 * w2) + u2 * (v0 * w1 - v1 * w0)
    return signed if abs(signed) > _FLAT else 0.0
