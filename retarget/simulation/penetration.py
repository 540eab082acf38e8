"""Which points lie inside of a skin, and how far from a surface."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retarget.types import FloatArray, IntArray

REACH = 10.0  # mm: points further away are not looked at
SLOT = 1.0  # mm: triangles are looked up by their left end, rays by squares of this side
MOST = 256  # squares in a row
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
    if not len(points) or not np.isfinite(x).all():
        return np.zeros(len(points), dtype=bool)
    return _leaves(x, np.ascontiguousarray(faces, dtype=np.int64), points) > 0


@njit(cache=True)
def _leaves(x, faces, points):  # type: ignore[no-untyped-def]
    """How often the ray along +z from SKIN off each point leaves the surface, less how often it enters it."""
    at = np.full(len(x), -1)
    starts = np.zeros((len(points), 3))  # normals at first
    at[points] = np.arange(len(points))
    e, length = np.empty((3, 3)), np.empty(3)
    for f in range(len(faces)):
        if at[faces[f, 0]] < 0 and at[faces[f, 1]] < 0 and at[faces[f, 2]] < 0:
            continue
        for corner in range(3):  # the edge from each corner to the next one
            for i in range(3):
                e[corner, i] = x[faces[f, (corner + 1) % 3], i] - x[faces[f, corner], i]
            length[corner] = np.sqrt(e[corner, 0] ** 2 + e[corner, 1] ** 2 + e[corner, 2] ** 2)
        n0 = e[0, 1] * e[1, 2] - e[0, 2] * e[1, 1]
        n1 = e[0, 2] * e[1, 0] - e[0, 0] * e[1, 2]
        n2 = e[0, 0] * e[1, 1] - e[0, 1] * e[1, 0]
        area = max(np.sqrt(n0 * n0 + n1 * n1 + n2 * n2), TINY)
        for corner in range(3):
            k, last = at[faces[f, corner]], (corner + 2) % 3
            if k < 0:
                continue
            cosine = -(e[corner, 0] * e[last, 0] + e[corner, 1] * e[last, 1] + e[corner, 2] * e[last, 2])
            cosine /= max(length[corner] * length[last], TINY)
            # Weighted by the angle: a point off a vertex is outside (Baerentzen, Aanaes 2005).
            weight = np.arccos(min(max(cosine, -1.0), 1.0)) / area
            starts[k, 0] += weight * n0
            starts[k, 1] += weight * n1
            starts[k, 2] += weight * n2
    for k in range(len(points)):
        scale = SKIN / max(np.sqrt(starts[k, 0] ** 2 + starts[k, 1] ** 2 + starts[k, 2] ** 2), TINY)
        for i in range(3):
            starts[k, i] = x[points[k], i] + scale * starts[k, i]
    left, right, bottom, top = starts[:, 0].min(), starts[:, 0].max(), starts[:, 1].min(), starts[:, 1].max()
    back = starts[:, 2].min()
    cell = max((right - left) / MOST, (top - bottom) / MOST, SLOT)
    wide, across = int((right - left) / cell) + 1, int((top - bottom) / cell) + 1
    column = np.empty(len(points), np.int64)
    for k in range(len(points)):
        column[k] = int((starts[k, 0] - left) / cell) * across + int((starts[k, 1] - bottom) / cell)
    order = np.argsort(column, kind="mergesort")
    first = np.searchsorted(column[order], np.arange(wide * across + 1))
    leaves = np.zeros(len(points), np.int64)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        high_y, low_y = max(x[a, 1], x[b, 1], x[c, 1]), min(x[a, 1], x[b, 1], x[c, 1])
        high_x, low_x = max(x[a, 0], x[b, 0], x[c, 0]), min(x[a, 0], x[b, 0], x[c, 0])
        front = max(x[a, 2], x[b, 2], x[c, 2])
        if high_y < bottom or low_y > top or high_x < left or low_x > right or front < back:
            continue
        n0 = (x[b, 1] - x[a, 1]) * (x[c, 2] - x[a, 2]) - (x[b, 2] - x[a, 2]) * (x[c, 1] - x[a, 1])
        n1 = (x[b, 2] - x[a, 2]) * (x[c, 0] - x[a, 0]) - (x[b, 0] - x[a, 0]) * (x[c, 2] - x[a, 2])
        n2 = (x[b, 0] - x[a, 0]) * (x[c, 1] - x[a, 1]) - (x[b, 1] - x[a, 1]) * (x[c, 0] - x[a, 0])
        lowest, highest = max(int((low_y - bottom) / cell), 0), min(int((high_y - bottom) / cell), across - 1)
        for i in range(max(int((low_x - left) / cell), 0), min(int((high_x - left) / cell), wide - 1) + 1):
            for k in order[first[i * across + lowest] : first[i * across + highest + 1]]:
                px, py, pz = starts[k, 0], starts[k, 1], starts[k, 2]
                if py < low_y or py > high_y or px < low_x or px > high_x or pz > front:
                    continue
                turns = _turn(x, a, b, px, py) + _turn(x, b, c, px, py) + _turn(x, c, a, px, py)
                if turns != 0 and turns * (n0 * (x[a, 0] - px) + n1 * (x[a, 1] - py) + n2 * (x[a, 2] - pz)) > 0:
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
