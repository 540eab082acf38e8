"""How deep points lie behind a surface, whatever the direction: along the normal of the nearest point."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.types import FloatArray, IntArray

REACH = 10.0  # mm: points further away are not looked at
SLOT = 1.0  # mm: triangles are looked up by their left end
ALIGNED = 0.5  # least cosine between the way to the nearest point and the normal there


class Surface:
    """An open surface, ready to measure depths behind it in any of its deformations."""

    def __init__(self, faces: IntArray, n: int) -> None:
        """faces (f, 3) of a mesh with n vertices."""
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        sides = np.sort(self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, counts = np.unique(sides, axis=0, return_counts=True)
        self._rim = np.zeros(n, dtype=bool)
        self._rim[edges[counts == 1]] = True

    def depths(self, vertices: FloatArray, points: IntArray) -> FloatArray:
        """(k,) mm for the vertices `points` (k,) of vertices (n, 3) mm: the distance from the nearest point of the
        surface if they lie behind it, else 0. Who is nearest to the rim is beside the surface, not behind it."""
        x = np.ascontiguousarray(vertices, dtype=np.float64)
        depths = np.zeros(len(points))
        if len(self.faces):
            _depths(x, points, self.faces, self._rim, depths)
        return depths


@njit(cache=True)
def _depths(x, points, faces, rim, depths):  # type: ignore[no-untyped-def]
    low, high, normals = np.empty((len(faces), 3)), np.empty((len(faces), 3)), np.zeros((len(x), 3))
    for f in range(len(faces)):
        a, b, c = x[faces[f, 0]], x[faces[f, 1]], x[faces[f, 2]]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            low[f, i], high[f, i] = min(a[i], b[i], c[i]), max(a[i], b[i], c[i])
            area = (b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j])
            for corner in range(3):
                normals[faces[f, corner], i] += area
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
                squared, s, t = _nearest(p, x[faces[f, 0]], x[faces[f, 1]], x[faces[f, 2]])
                if squared < best:
                    best, nearest = squared, f
                    weights[0], weights[1], weights[2] = 1 - s - t, s, t
        if nearest < 0:
            continue
        inner, along, length = False, 0.0, 0.0
        for corner in range(3):
            inner = inner or (weights[corner] > 1e-9 and not rim[faces[nearest, corner]])
        for i in range(3):
            way, normal = -p[i], 0.0
            for corner in range(3):
                way += weights[corner] * x[faces[nearest, corner], i]
                normal += weights[corner] * normals[faces[nearest, corner], i]
            along += way * normal
            length += normal * normal
        if inner and along > ALIGNED * np.sqrt(length * best):
            depths[k] = np.sqrt(best)


@njit(cache=True)
def _nearest(p, a, b, c):  # type: ignore[no-untyped-def]
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
