"""Which points lie inside of a skin, and how far from a surface."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retarget.types import FloatArray, IntArray

REACH = 10.0  # mm: points further away are not looked at
SLOT = 1.0  # mm: triangles are looked up by their left end
TINY = 1e-300  # instead of 0 as a divisor
SKIN = 0.02  # mm: what is less deep inside of the skin is on it


class Surface:
    """A surface, ready to find nearest points in any of its deformations."""

    def __init__(self, faces: IntArray) -> None:
        """faces (f, 3)."""
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)

    def nearest(self, vertices: FloatArray, points: IntArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Distances (k,) mm of the vertices `points` (k,) of vertices (n, 3) mm from the surface, at most REACH, on
        whatever side; the triangles (k, 3) of the nearest points, and their barycentric coordinates (k, 3), which are
        0 beyond REACH."""
        x, k = np.ascontiguousarray(vertices, dtype=np.float64), len(points)
        distances, triangles, barycentric = np.full(k, REACH), np.zeros((k, 3), dtype=np.int64), np.zeros((k, 3))
        if len(self.faces) and k:
            _nearest_points(x, points, self.faces, distances, triangles, barycentric)
        return distances, triangles, barycentric


def inside(vertices: FloatArray, faces: IntArray, points: IntArray) -> NDArray[np.bool_]:
    """(k,) which of the vertices `points` (k,) of a skin (n, 3) mm, (f, 3) lie inside of it, by more than SKIN.

    A ray forward, along +z, leaves the skin as often as it enters it if it starts outside: the winding number, also
    of a skin that crosses itself. The skin may be open where no such ray passes, as at the neck and behind.
    """
    x = np.ascontiguousarray(vertices, dtype=np.float64)
    return _leaves(x, np.ascontiguousarray(faces, dtype=np.int64), points) > 0


@njit(cache=True)
def _leaves(x, faces, points):  # type: ignore[no-untyped-def]
    """How often the ray along +z from SKIN off each point leaves the surface, less how often it enters it."""
    at = np.full(len(x), -1)
    normals = np.zeros((len(points), 3))
    at[points] = np.arange(len(points))
    for f in range(len(faces)):
        a, b, c = faces[f]
        if at[a] < 0 and at[b] < 0 and at[c] < 0:
            continue
        for corner in range(3):
            o, p, q = faces[f, corner], faces[f, (corner + 1) % 3], faces[f, (corner + 2) % 3]
            if at[o] < 0:
                continue
            u, v = x[p] - x[o], x[q] - x[o]
            cosine = np.dot(u, v) / max(np.sqrt(np.dot(u, u) * np.dot(v, v)), TINY)
            normal = np.cross(u, v)  # weighted by the angle: a point off a vertex is outside (Baerentzen, Aanaes 2005)
            normals[at[o]] += (
                np.arccos(min(max(cosine, -1.0), 1.0)) * normal / max(np.sqrt(np.dot(normal, normal)), TINY)
            )
    starts = np.empty((len(points), 3))
    for k in range(len(points)):
        starts[k] = x[points[k]] + SKIN * normals[k] / max(np.sqrt(np.dot(normals[k], normals[k])), TINY)
    order = np.argsort(starts[:, 0], kind="mergesort")
    sorted_x = starts[order, 0]
    bottom, top, back = starts[:, 1].min(), starts[:, 1].max(), starts[:, 2].min()
    leaves = np.zeros(len(points), np.int64)
    for f in range(len(faces)):
        a, b, c = faces[f]
        high_y, low_y = max(x[a, 1], x[b, 1], x[c, 1]), min(x[a, 1], x[b, 1], x[c, 1])
        front = max(x[a, 2], x[b, 2], x[c, 2])
        if high_y < bottom or low_y > top or front < back:
            continue
        first = np.searchsorted(sorted_x, min(x[a, 0], x[b, 0], x[c, 0]))
        for k in order[first : np.searchsorted(sorted_x, max(x[a, 0], x[b, 0], x[c, 0]), side="right")]:
            px, py, pz = starts[k]
            if py < low_y or py > high_y or pz > front:
                continue
            turns = _turn(x, a, b, px, py) + _turn(x, b, c, px, py) + _turn(x, c, a, px, py)
            if turns == 0:
                continue
            normal = np.cross(x[b] - x[a], x[c] - x[a])
            ahead = normal[0] * (x[a, 0] - px) + normal[1] * (x[a, 1] - py) + normal[2] * (x[a, 2] - pz)
            if turns * ahead > 0:
                leaves[k] += turns
    return leaves


@njit(cache=True)
def _turn(x, a, b, px, py):  # type: ignore[no-untyped-def]
    """How the edge ab, seen along z, turns about (px, py): 1 if it passes right of it upwards, -1 downwards, else 0.

    Triangles at one edge get the same answer with opposite signs, so no ray slips between them.
    """
    low, high, sign = a, b, 1
    if x[a, 1] > x[b, 1]:
        low, high, sign = b, a, -1
    if not x[low, 1] <= py < x[high, 1]:
        return 0
    along = (py - x[low, 1]) / (x[high, 1] - x[low, 1])
    return sign if px < x[low, 0] + along * (x[high, 0] - x[low, 0]) else 0


@njit(cache=True)
def _nearest_points(x, points, faces, distances, triangles, barycentric):  # type: ignore[no-untyped-def]
    low, high = np.empty((len(faces), 3)), np.empty((len(faces), 3))
    for f in range(len(faces)):
        a, b, c = x[faces[f, 0]], x[faces[f, 1]], x[faces[f, 2]]
        for i in range(3):
            low[f, i], high[f, i] = min(a[i], b[i], c[i]), max(a[i], b[i], c[i])
    left, widest = low[:, 0].min(), (high[:, 0] - low[:, 0]).max()
    slot = ((low[:, 0] - left) / SLOT).astype(np.int64)
    slots = slot.max() + 1
    order = np.argsort(slot, kind="mergesort")
    start = np.searchsorted(slot[order], np.arange(slots + 1))
    weights = np.empty(3)
    for k in range(len(points)):
        p = x[points[k]]
        best, nearest = REACH * REACH, -1
        own = min(max(int(np.floor((p[0] - left) / SLOT)), 0), slots - 1)
        for turn in range(2 * slots):  # outwards from the point's own slot
            c = own + (turn + 1) // 2 * (1 - 2 * (turn % 2))
            if c < 0 or c >= slots:
                continue
            aside = max(left + c * SLOT - p[0], p[0] - (left + (c + 1) * SLOT + widest), 0.0)
            if aside * aside >= best:
                continue
            for f in order[start[c] : start[c + 1]]:
                squared = 0.0
                for i in range(3):
                    gap = max(low[f, i] - p[i], p[i] - high[f, i], 0.0)
                    squared += gap * gap
                if squared >= best:
                    continue
                squared, s, t = nearest_on_triangle(p, x[faces[f, 0]], x[faces[f, 1]], x[faces[f, 2]])
                if squared < best:
                    best, nearest = squared, f
                    weights[0], weights[1], weights[2] = 1 - s - t, s, t
        if nearest < 0:
            continue
        distances[k] = np.sqrt(best)
        for corner in range(3):
            triangles[k, corner], barycentric[k, corner] = faces[nearest, corner], weights[corner]


@njit(cache=True)
def nearest_on_triangle(p, a, b, c):  # type: ignore[no-untyped-def]
    """Squared distance of p from triangle abc, and the weights of b and c at its nearest point.

    By the regions of Ericson 2005, "Real-Time Collision Detection", section 5.1.5.
    """
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for i in range(3):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 += ab * (p[i] - a[i])
        d2 += ac * (p[i] - a[i])
        d3 += ab * (p[i] - b[i])
        d4 += ac * (p[i] - b[i])
        d5 += ab * (p[i] - c[i])
        d6 += ac * (p[i] - c[i])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        s, t = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        s, t = 1.0, 0.0
    elif d6 >= 0 and d5 <= d6:
        s, t = 0.0, 1.0
    elif vc <= 0 <= d1 and d3 <= 0:
        s, t = d1 / (d1 - d3), 0.0
    elif vb <= 0 <= d2 and d6 <= 0:
        s, t = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s = 1 - t
    else:
        s, t = vb / (va + vb + vc), vc / (va + vb + vc)
    squared = 0.0
    for i in range(3):
        gap = p[i] - (1 - s - t) * a[i] - s * b[i] - t * c[i]
        squared += gap * gap
    return squared, s, t
