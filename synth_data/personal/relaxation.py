"""Skin that folds into itself gives way: motion evens out about new crossings, no farther than it must.

Contact parts the lips and the rims of the lids; what remains are creases where the skin meets its own lining, as behind
the corners of a pursed mouth. There displacements are averaged in space, until no pair of triangles crosses that does
not cross at rest: sheets that touch move alike, and a field whose gradient is small lets nothing pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from retarget.anatomy.crossings import self_intersections
from retarget.geometry.graph import components
from retarget.types import FloatArray, IntArray
from synth_data.personal.shares import smoothstep

WITHIN = 20.0  # mm from what folds
CORE, FADE = 2.0, 9.0  # mm about a crossing that give way in full, and over which that fades
WIDTHS = (0.3, 1.0, 2.0, 4.0, 8.0, 16.0)  # mm over which displacements are averaged; the first that helps
HALVINGS = 3  # between it and the one before, so that little changes where a crossing has just begun
ROUNDS = 6  # in each of which crossings that are left, or new, are treated with those before


@dataclass(frozen=True)
class Relaxation:
    """A part of one neutral in which crossings are looked for and mended."""

    neutral: FloatArray  # (k, 3) mm
    vertices: IntArray  # (k,) of the face
    faces: IntArray  # (f, 3) rows of `vertices`
    mass: FloatArray  # (k,) mm^2
    at_rest: IntArray  # keys of pairs of triangles that cross in the neutral

    def __call__(self, skin: FloatArray) -> FloatArray:
        """(n, 3) mm without new crossings, for skin (n, 3); the same array where there are none.

        Where `ROUNDS` leave some, the round with the fewest vertices on them counts.
        """
        at = best = skin[self.vertices]
        found = fewest = self._crossing(at)
        if not len(found):
            return skin
        for _ in range(ROUNDS):
            relaxed = at.copy()
            for place in self._places(found):
                spread = self._spread(place)
                rows = np.flatnonzero(spread > 0)
                relaxed[rows] = self._least(at, rows, spread[rows])
            crossing = self._crossing(relaxed)
            if len(crossing) < len(fewest):
                best, fewest = relaxed, crossing
            if not len(crossing):
                break
            found = np.union1d(found, crossing)
        out = skin.copy()
        out[self.vertices] = best
        return out

    def _least(self, at: FloatArray, rows: IntArray, spread: FloatArray) -> FloatArray:
        """(m, 3) mm: vertices `rows` of (k, 3), their displacements averaged as little as leaves no new crossing."""
        triangles = np.flatnonzero(np.isin(self.faces, rows).any(axis=1))

        def averaged(width: float) -> tuple[bool, FloatArray]:
            moved = at.copy()
            moved[rows] = self.neutral[rows] + self._evened(rows, at[rows] - self.neutral[rows], spread, width)
            return not len(self._crossing(moved, triangles)), moved[rows]

        tight = 0.0
        for wide in WIDTHS:
            clear, best = averaged(wide)
            if clear:
                break
            tight = wide
        else:
            return best
        for _ in range(HALVINGS):
            middle = 0.5 * (tight + wide)
            clear, moved = averaged(middle)
            tight, wide, best = (tight, middle, moved) if clear else (middle, wide, best)
        return best

    def _evened(self, rows: IntArray, moved: FloatArray, spread: FloatArray, width: float) -> FloatArray:
        """(m, 3) mm: displacements (m, 3), by their share `spread` (m,) the averages over `width` mm of space."""
        near = np.exp(-0.5 * cdist(self.neutral[rows], self.neutral[rows], "sqeuclidean") / width**2) * self.mass[rows]
        mean = near @ moved / near.sum(axis=1, keepdims=True)
        return np.asarray(moved + spread[:, None] * (mean - moved))

    def _places(self, crossing: IntArray) -> list[IntArray]:
        """The crossing vertices, parted so that what gives way about one part does not reach into another's."""
        tree = cKDTree(self.neutral[crossing])
        together = tree.sparse_distance_matrix(tree, 2 * (CORE + FADE), output_type="coo_matrix")
        return [crossing[part] for part in components(sp.csr_array(together))]

    def _spread(self, crossing: IntArray) -> FloatArray:
        """(k,) 1 about the crossing vertices, 0 away from them."""
        away = cKDTree(self.neutral[crossing]).query(self.neutral)[0]
        return 1 - smoothstep((away - CORE) / FADE)

    def _crossing(self, at: FloatArray, triangles: IntArray | None = None) -> IntArray:
        """Vertices of pairs of triangles that cross at (k, 3) mm but not at rest."""
        pairs = self_intersections(at, self.faces if triangles is None else self.faces[triangles])
        pairs = pairs if triangles is None else triangles[pairs]
        new = ~np.isin(_keys(pairs, len(self.faces)), self.at_rest)
        return np.unique(self.faces[pairs[new]])


def relaxation_of(vertices: FloatArray, faces: IntArray, mass: FloatArray, folding: IntArray) -> Relaxation:
    """The part of a neutral (n, 3) mm with faces (f, 3) and areas (n,) mm^2 that is near vertices `folding`."""
    near: NDArray[np.bool_] = cKDTree(vertices[folding]).query(vertices)[0] < WITHIN
    chosen = faces[near[faces].all(axis=1)]
    used = np.unique(chosen)
    local = np.searchsorted(used, chosen)
    pairs = self_intersections(vertices[used], local)
    return Relaxation(vertices[used], used, local, mass[used], _keys(pairs, len(local)))


def _keys(pairs: IntArray, count: int) -> IntArray:
    """(p,) one number for each pair of `count` triangles, whichever comes first."""
    low, high = np.sort(pairs, axis=1).T
    return np.asarray(low * count + high)
