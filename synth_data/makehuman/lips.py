"""Lips that meet at rest without passing each other: the least smooth lift of one and drop of the other.

MakeHuman's macro targets push the lips of half of all adults through each other. Up is +y, and everything moves along
it alone, so that what lies above what does not change, and the gap between two points is linear in the displacement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from retarget.anatomy.crossings import self_intersections
from retarget.geometry.cholesky import CholeskyFactor
from retarget.geometry.graph import vertex_adjacency
from retarget.geometry.laplacian import surface_energies
from retarget.types import FloatArray, IntArray, Regions
from synth_data.lip_contact import compliance, least, missing_gaps, sides
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.subdivide import subdivide

GAP = 0.08  # mm that are left between the lips where they passed each other
REACH, MEETING = 16.0, 5.0  # mm from the lips beyond which nothing moves, and within which they may meet
SMOOTH = 4.0  # mm over which the displacement fades
RINGS, SHARES = 5, (0.25, 0.5, 0.75, 1.0)  # of vertices about a fold, and of the way to the base head's shape


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
        self._compliance = compliance(stiffness, mass, self._free, SMOOTH)
        side = sides(stiffness, regions)
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
        rows, missing = [], []
        for sheets in self._sheets:
            of_sheets, lacking = missing_gaps(sheets.operator @ vertices, sheets.upper, sheets.lower, GAP)
            rows.append(of_sheets @ sheets.operator)
            missing.append(lacking)
        touching = sp.csr_array(sp.vstack(rows, format="csr")[:, self._free])
        moved = vertices.copy()
        moved[self._free, 1] += least(self._compliance, touching, np.concatenate(missing))
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
