"""How far samples of one surface are from another one that faces them, and on which side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from retarget.simulation.penetration import TINY, nearest_on_triangle
from retarget.types import FloatArray, IntArray

FACING = 0.2  # largest cosine between the normals of a sample and of a triangle that it may touch
ON_EDGE = 1e-9  # barycentric coordinates below are 0
MOST = 48  # cubes in a row
CLOSE = 0.02  # mm: nearer than this the direction to the nearest point says little


@dataclass(frozen=True)
class Samples:
    """Points of a surface, each a mean of three vertices."""

    corners: IntArray  # (s, 3)
    weights: FloatArray  # (s, 3)

    @classmethod
    def of(cls, vertices: IntArray, faces: IntArray) -> Samples:
        """The vertices (v,), then the centres of faces (f, 3)."""
        alone = np.tile([1.0, 0.0, 0.0], (len(vertices), 1))
        corners = np.vstack([np.repeat(vertices[:, None], 3, axis=1), faces])
        return cls(np.ascontiguousarray(corners), np.vstack([alone, np.full((len(faces), 3), 1 / 3)]))

    @property
    def count(self) -> int:
        return len(self.corners)


@dataclass(frozen=True)
class Gaps:
    """Of each sample its signed distance from the other surface, negative inside, infinite out of reach; where the
    nearest point is; and the direction in which the gap opens."""

    gap: FloatArray  # (s,) mm
    corners: IntArray  # (s, 3) of the triangle that holds the nearest point
    weights: FloatArray  # (s, 3) barycentric
    normal: FloatArray  # (s, 3) of length 1

    @classmethod
    def stack(cls, parts: list[Gaps]) -> Gaps:
        fields = ("gap", "corners", "weights", "normal")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))


class FacingSurface:
    """A surface, perhaps open, in any of its deformations.

    Inside is what lies behind the nearest point, by the normal of its triangle, edge or vertex (Baerentzen, Aanaes
    2005). A sample whose nearest point lies on the rim is beyond the surface and has no gap. The nearest point is
    sought again on triangles that face the sample, so that what entered a thin lip leaves it where it came in.
    """

    def __init__(self, faces: IntArray, vertices: int) -> None:
        """faces (f, 3) on so many vertices."""
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        opposite = self.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
        keys = np.sort(opposite, axis=1) @ [vertices, 1]
        order = np.argsort(keys, kind="stable")
        twice = np.flatnonzero(keys[order][1:] == keys[order][:-1])
        one, other = order[twice], order[twice + 1]
        beyond = np.full(3 * len(self.faces), -1)
        beyond[one], beyond[other] = other // 3, one // 3
        self._rim = np.zeros(vertices, dtype=bool)
        self._rim[opposite[beyond < 0]] = True
        self._beyond = beyond.reshape(-1, 3)  # the triangle across the edge opposite to each corner, or -1

    def gaps(self, x: FloatArray, normals: FloatArray, samples: Samples, near: float, reach: float) -> Gaps:
        """Gaps of samples on vertices x (v, 3) mm with normals (v, 3): at most `near` mm, at least -`reach` mm."""
        count = samples.count
        found = Gaps(np.full(count, np.inf), np.zeros((count, 3), np.int64), np.zeros((count, 3)), np.zeros((count, 3)))
        if count and len(self.faces) and np.isfinite(x).all():
            surface = self.faces, self._beyond, self._rim
            parts = found.gap, found.corners, found.weights, found.normal
            _gaps(x, normals, samples.corners, samples.weights, *surface, near, reach, *parts)
        return found


@njit(cache=True)
def vertex_normals(x, faces):  # type: ignore[no-untyped-def]
    """(v, 3) of length 1, or 0 without a triangle: those of the triangles, weighted by their angles."""
    normals = np.zeros_like(x)
    e = np.empty((3, 3))  # edges, each from a corner to the next one
    for f in range(len(faces)):
        for corner in range(3):
            for i in range(3):
                e[corner, i] = x[faces[f, (corner + 1) % 3], i] - x[faces[f, corner], i]
        n0 = e[0, 1] * e[1, 2] - e[0, 2] * e[1, 1]
        n1 = e[0, 2] * e[1, 0] - e[0, 0] * e[1, 2]
        n2 = e[0, 0] * e[1, 1] - e[0, 1] * e[1, 0]
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if length > 0:
            for corner in range(3):
                last = (corner + 2) % 3
                cosine = -(e[corner, 0] * e[last, 0] + e[corner, 1] * e[last, 1] + e[corner, 2] * e[last, 2])
                weight, o = np.arctan2(length, cosine) / length, faces[f, corner]
                normals[o, 0] += weight * n0
                normals[o, 1] += weight * n1
                normals[o, 2] += weight * n2
    for i in range(len(x)):
        length = np.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2 + normals[i, 2] ** 2)
        for c in range(3):
            normals[i, c] /= max(length, TINY)
    return normals


@njit(cache=True)
def _cells(low, high, reach):  # type: ignore[no-untyped-def]
    """Cubes, each with the triangles whose boxes come as close to it as `reach`: their side, the lowest corner of the
    first one, their counts, and the triangles of each."""
    origin, counts, side = np.empty(3), np.empty(3, np.int64), reach
    for i in range(3):
        origin[i] = low[:, i].min() - reach
        side = max(side, (high[:, i].max() + reach - origin[i]) / MOST)
    for i in range(3):
        counts[i] = int((high[:, i].max() + reach - origin[i]) / side) + 1
    first, last = np.empty((len(low), 3), np.int64), np.empty((len(low), 3), np.int64)
    for f in range(len(low)):
        for i in range(3):
            first[f, i] = int((low[f, i] - reach - origin[i]) / side)
            last[f, i] = int((high[f, i] + reach - origin[i]) / side)
    starts = np.zeros(counts[0] * counts[1] * counts[2] + 1, np.int64)
    for filling in range(2):
        if filling:
            starts = np.cumsum(starts)
            content, at = np.empty(starts[-1], np.int64), starts[:-1].copy()
        for f in range(len(low)):
            for a in range(first[f, 0], last[f, 0] + 1):
                for b in range(first[f, 1], last[f, 1] + 1):
                    row = (a * counts[1] + b) * counts[2]
                    for cell in range(row + first[f, 2], row + last[f, 2] + 1):
                        if filling:
                            content[at[cell]] = f
                            at[cell] += 1
                        else:
                            starts[cell + 1] += 1
    return side, origin, counts, starts, content


@njit(cache=True)
def _gaps(x, normals, own, mean, faces, beyond, rim, near, reach, gap, corners, weights, direction):  # type: ignore[no-untyped-def]
    count = len(faces)
    low, high, flat = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    for f in range(count):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for i in range(3):
            low[f, i], high[f, i] = min(x[a, i], x[b, i], x[c, i]), max(x[a, i], x[b, i], x[c, i])
            j, k = (i + 1) % 3, (i + 2) % 3
            flat[f, i] = (x[b, j] - x[a, j]) * (x[c, k] - x[a, k]) - (x[b, k] - x[a, k]) * (x[c, j] - x[a, j])
        length = np.sqrt(flat[f, 0] ** 2 + flat[f, 1] ** 2 + flat[f, 2] ** 2)
        for i in range(3):
            flat[f, i] /= max(length, TINY)
    cube, origin, counts, starts, content = _cells(low, high, reach)
    p, up = np.empty(3), np.empty(3)
    for k in range(len(own)):
        cell, beside = 0, False
        for i in range(3):
            p[i] = up[i] = 0.0
            for j in range(3):
                p[i] += mean[k, j] * x[own[k, j], i]
                up[i] += mean[k, j] * normals[own[k, j], i]
            slot = int(np.floor((p[i] - origin[i]) / cube))
            beside = beside or slot < 0 or slot >= counts[i]
            cell = cell * counts[i] + slot
        if beside:
            continue
        limit = FACING * np.sqrt(up[0] ** 2 + up[1] ** 2 + up[2] ** 2)
        best, at, s, t = reach * reach, -1, 0.0, 0.0  # of all triangles
        best_facing, facing, s_facing, t_facing = best, -1, 0.0, 0.0
        for f in content[starts[cell] : starts[cell + 1]]:
            squared = 0.0
            for i in range(3):
                aside = max(low[f, i] - p[i], p[i] - high[f, i], 0.0)
                squared += aside * aside
            if squared >= best_facing:
                continue
            faces_it = flat[f, 0] * up[0] + flat[f, 1] * up[1] + flat[f, 2] * up[2] <= limit
            if squared >= best and not faces_it:
                continue
            squared, u, v = nearest_on_triangle(p, x[faces[f, 0]], x[faces[f, 1]], x[faces[f, 2]])
            if squared < best:
                best, at, s, t = squared, f, u, v
            if faces_it and squared < best_facing:
                best_facing, facing, s_facing, t_facing = squared, f, u, v
        if at < 0 or facing < 0:
            continue
        side = _side(p, x, normals, flat, faces, beyond, rim, at, s, t)
        if side == 0 or side != _side(p, x, normals, flat, faces, beyond, rim, facing, s_facing, t_facing):
            continue
        distance = np.sqrt(best_facing)
        if side > 0 and distance > near:
            continue
        gap[k] = side * distance
        weights[k, 0], weights[k, 1], weights[k, 2] = 1 - s_facing - t_facing, s_facing, t_facing
        for i in range(3):
            corners[k, i] = faces[facing, i]
        for i in range(3):
            away, smooth = p[i], 0.0
            for j in range(3):
                away -= weights[k, j] * x[corners[k, j], i]
                smooth += weights[k, j] * normals[corners[k, j], i]
            direction[k, i] = side * away / distance if distance > CLOSE else smooth
        length = max(np.sqrt(direction[k, 0] ** 2 + direction[k, 1] ** 2 + direction[k, 2] ** 2), TINY)
        for i in range(3):
            direction[k, i] /= length


@njit(cache=True)
def _side(p, x, normals, flat, faces, beyond, rim, f, s, t):  # type: ignore[no-untyped-def]
    """1 outside and -1 inside, seen from the nearest point on triangle f; 0 if that lies on the rim."""
    on_rim, zeros, zero, last = True, 0, 0, 0
    for i in range(3):
        if (1 - s - t if i == 0 else s if i == 1 else t) < ON_EDGE:
            zeros, zero = zeros + 1, i
        else:
            last = i
            on_rim = on_rim and rim[faces[f, i]]
    if on_rim:
        return 0
    across, along = beyond[f, zero], 0.0
    for i in range(3):
        away = p[i] - (1 - s - t) * x[faces[f, 0], i] - s * x[faces[f, 1], i] - t * x[faces[f, 2], i]
        if zeros == 2:
            along += away * normals[faces[f, last], i]
        elif zeros == 1 and across >= 0:
            along += away * (flat[f, i] + flat[across, i])
        else:
            along += away * flat[f, i]
    return -1 if along < 0 else 1
