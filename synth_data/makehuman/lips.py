"""Lips that meet at rest without passing each other: the least smooth lift of one and drop of the other.

MakeHuman's macro targets push the lips of half of all adults through each other. Up is +y, and everything moves along
it alone, so that what lies above what does not change, and the gap between two points is linear in the displacement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree

from retarget.anatomy.crossings import self_intersections
from retarget.geometry.cholesky import CholeskyFactor
from retarget.geometry.graph import vertex_adjacency
from retarget.geometry.laplacian import surface_energies
from retarget.types import FloatArray, IntArray, Regions
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.subdivide import subdivide

GAP = 0.08  # mm that are left between the lips where they passed each other
REACH, MEETING = 16.0, 5.0  # mm from the lips beyond which nothing moves, and within which they may meet
SMOOTH = 4.0  # mm over which the displacement fades
LOOK = 3.0  # mm of height within which two triangles may come to touch
RINGS, SHARES = 5, (0.25, 0.5, 0.75, 1.0)  # of vertices about a fold, and of the way to the base head's shape
STIFFNESS = 1e5  # of contact, relative to the skin: 0.01 mm of the gap are lost
ROUNDS, SETTLED = 40, 1e-3  # of the contact's active set; mm of change that end them


@dataclass(frozen=True)
class Sheets:
    """Triangles of both lips on one resolution."""

    operator: sp.csr_array  # (m, n) from the base head
    upper: IntArray  # (a, 3)
    lower: IntArray  # (b, 3)
    near: IntArray  # (c, 3) these and the triangles about them


class RestingLips:
    """Parts the lips of heads on one topology, on the base mesh and after one step of Loop subdivision."""

    def __init__(self, head: BaseHead, regions: Regions) -> None:
        """The base head decides who lies above whom; needs the vertex sets lips, upper_lip and lower_lip."""
        n = len(head.vertices)
        stiffness, mass = surface_energies(head.vertices, head.faces)
        lips = regions.vertices["lips"]
        away = cKDTree(head.vertices[lips]).query(head.vertices)[0]
        self._free = np.flatnonzero(away < REACH)
        screened = sp.diags_array(mass) + SMOOTH**2 * stiffness
        energy = sp.csr_array(screened @ sp.diags_array(1 / mass) @ screened)
        self._energy = energy[self._free][:, self._free].toarray()
        side = _sides(stiffness, regions, n)
        fine = subdivide(head.faces, n, 1)
        self._base, self._adjacency = head.vertices, vertex_adjacency(head.faces, n)
        self._bending = sp.csr_array(stiffness @ sp.diags_array(1 / mass) @ stiffness)
        self._movable = away < REACH
        self._sheets = [
            _sheets(sp.eye_array(n, format="csr"), head.faces, side, away),
            _sheets(fine.operator, fine.faces, side, away),
        ]

    def __call__(self, vertices: FloatArray) -> FloatArray:
        """(n, 3) mm with lips that touch; the same bits where they did not pass each other."""
        if not len(self._crossing(vertices)):
            return vertices
        parted = self._parted(vertices)
        crossing = self._crossing(parted)
        return self._unfolded(parted, crossing) if len(crossing) else parted

    def _crossing(self, vertices: FloatArray) -> IntArray:
        """Vertices of crossing triangles on the base mesh, and those that decide such on the fine one."""
        return np.unique(np.concatenate([_crossing(sheets, vertices) for sheets in self._sheets]))

    def _parted(self, vertices: FloatArray) -> FloatArray:
        """What lies above stays above, by `GAP`."""
        rows, missing = zip(*(_gaps(sheets, vertices) for sheets in self._sheets), strict=True)
        touching = sp.vstack(rows, format="csr")[:, self._free]
        moved = vertices.copy()
        moved[self._free, 1] += _least(self._energy, touching, np.concatenate(missing))
        return moved

    def _unfolded(self, vertices: FloatArray, crossing: IntArray) -> FloatArray:
        """A lip that folds over its own lining takes the base head's shape there, bent smoothly to what is about it.

        The smallest neighbourhood that helps is taken, by the least share of the way; the one with the fewest
        crossings if none does.
        """
        change, found = vertices - self._base, []
        part = np.zeros(len(vertices), dtype=bool)
        part[crossing] = True
        for _ in range(RINGS):
            part = part | (self._adjacency @ part > 0)
            inside = np.flatnonzero(part & self._movable)
            outside = np.setdiff1d(np.arange(len(vertices)), inside)
            rows = self._bending[inside]
            factor = CholeskyFactor(sp.csc_array(rows[:, inside]), "lips")
            bend = -factor.solve(np.asarray(rows[:, outside] @ change[outside])) - change[inside]
            for share in SHARES:
                bent = vertices.copy()
                bent[inside] += share * bend
                found.append((len(self._crossing(bent)), bent))
                if not found[-1][0]:
                    return bent
        return min(found, key=lambda each: each[0])[1]


def _sides(stiffness: sp.csr_array, regions: Regions, n: int) -> FloatArray:
    """(n,) 0 on the upper lip and 1 on the lower one, harmonic between and over the lining of the mouth."""
    upper, lower = regions.vertices["upper_lip"], regions.vertices["lower_lip"]
    values = np.full(n, np.nan)
    values[np.setdiff1d(upper, lower)], values[np.setdiff1d(lower, upper)] = 0.0, 1.0
    free = np.isnan(values)
    rest = sp.csc_array(stiffness[free][:, free] + 1e-9 * sp.eye_array(int(free.sum())))
    values[free] = sp.linalg.spsolve(rest, -(stiffness[free][:, ~free] @ values[~free]))
    return values


def _sheets(operator: sp.csr_array, faces: IntArray, side: FloatArray, away: FloatArray) -> Sheets:
    """The sheets of one resolution, for vertices of the base head `away` (n,) mm from the lips."""
    distance = np.asarray(operator @ away)[faces].max(axis=1)
    near, faces = faces[distance < REACH], faces[distance < MEETING]
    of = np.asarray(operator @ side)[faces].mean(axis=1)
    return Sheets(operator, faces[of < 0.5], faces[of >= 0.5], near)


def _crossing(sheets: Sheets, vertices: FloatArray) -> IntArray:
    """Vertices of the base head that decide where triangles of the sheets cross."""
    corners = sheets.near[np.unique(self_intersections(np.asarray(sheets.operator @ vertices), sheets.near))]
    weights = sheets.operator[np.unique(corners)]
    return np.unique(weights.indices[weights.data > 0.2])


def _gaps(sheets: Sheets, vertices: FloatArray) -> tuple[sp.csr_array, FloatArray]:
    """Rows (c, n) that give how the gap grows between points above each other, and what is missing (c,) mm.

    Gaps between two triangles are least at a corner of either or where their edges cross, seen from above.
    """
    at = np.asarray(sheets.operator @ vertices)
    plane, height = at[:, [0, 2]], at[:, 1]
    upper, lower = _facing(sheets, plane, height)
    indices, weights = [], []
    for corner in range(3):
        for one, other, sign in ((upper, lower, 1.0), (lower, upper, -1.0)):
            point, triangle = one[:, corner], other
            share = _barycentric(plane[point], plane[triangle])
            inside = (share >= 0).all(axis=1)
            indices.append(np.column_stack([point, triangle])[inside])
            weights.append(sign * np.column_stack([np.ones(len(point)), -share])[inside])
    for i in range(3):
        for j in range(3):
            ends = np.column_stack([upper[:, [i, (i + 1) % 3]], lower[:, [j, (j + 1) % 3]]])
            s, t = _meet(*(plane[ends[:, k]] for k in range(4)))
            inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
            indices.append(ends[inside])
            weights.append(np.column_stack([1 - s, s, t - 1, -t])[inside])
    index, weight = np.concatenate(indices), np.concatenate(weights)
    rows = sp.csr_array(
        (weight.ravel(), (np.repeat(np.arange(len(index)), 4), index.ravel())), shape=(len(index), len(at))
    )
    return sp.csr_array(rows @ sheets.operator), GAP - rows @ height


def _facing(sheets: Sheets, plane: FloatArray, height: FloatArray) -> tuple[IntArray, IntArray]:
    """Pairs of triangles (p, 3), (p, 3) that overlap seen from above and are near each other in height."""
    near: NDArray[np.bool_] = np.ones((len(sheets.upper), len(sheets.lower)), dtype=bool)
    for values, slack in ((plane[:, 0], 0.0), (plane[:, 1], 0.0), (height, LOOK)):
        of_upper, of_lower = values[sheets.upper], values[sheets.lower]
        near &= of_upper.min(axis=1)[:, None] <= of_lower.max(axis=1) + max(slack, GAP)
        near &= of_lower.min(axis=1) <= of_upper.max(axis=1)[:, None] + slack
    one, other = np.nonzero(near)
    upper, lower = sheets.upper[one], sheets.lower[other]
    apart = ~(upper[:, :, None] == lower[:, None]).any(axis=(1, 2))
    return upper[apart], lower[apart]


def _barycentric(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """(k, 3) of points (k, 2) in triangles (k, 3, 2); outside, and in flat triangles, one is negative."""
    a, b, c = (corner - points for corner in np.moveaxis(triangles, 1, 0))
    parts = np.stack([_turn(b, c), _turn(c, a), _turn(a, b)], axis=1)
    total = parts.sum(axis=1, keepdims=True)
    flat = np.abs(total) < 1e-6  # mm^2
    return np.where(flat, -1.0, parts / np.where(flat, 1.0, total))


def _meet(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where lines ab and cd, each (k, 2), cross, as shares (k,), (k,) of their lengths; -1 if they are parallel."""
    one, other, between = b - a, d - c, c - a
    area = _turn(one, other)
    flat = np.abs(area) < 1e-6
    area = np.where(flat, 1.0, area)
    s, t = _turn(between, other) / area, _turn(between, one) / area
    return np.where(flat, -1.0, s), np.where(flat, -1.0, t)


def _turn(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _least(energy: FloatArray, rows: sp.csr_array, missing: FloatArray) -> FloatArray:
    """(k,) mm: the u of least energy with rows @ u >= missing, by Newton's method on the contact's penalty."""
    u, active = np.zeros(len(energy)), missing > 0
    for _ in range(ROUNDS):
        touching = rows[active]
        total = energy + STIFFNESS * (touching.T @ touching).toarray()
        before, u = u, cho_solve(cho_factor(total), STIFFNESS * (touching.T @ missing[active]))
        now = missing > rows @ u
        if (now == active).all() or np.abs(u - before).max() < SETTLED:
            break
        active = now
    return u
