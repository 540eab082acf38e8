"""The tissue between skin and skull as tetrahedra, and its refinement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from retarget.types import FloatArray, IntArray

_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
_DIAGONALS = ((0, 5), (1, 4), (2, 3))  # opposite edges: the octahedron inside a tet is cut along one of the three


@dataclass(frozen=True)
class Tissue:
    """All tissue of one head, soft and muscle."""

    vertices: FloatArray  # (m, 3) mm
    tets: IntArray  # (t, 4), positively oriented
    skull_faces: IntArray  # (g, 3) into vertices, facing out of the bone


def refine(tissue: Tissue) -> Tissue:
    """Each tet cut into eight of an eighth of its volume, each skull triangle into four (Bey 1995, `Tetrahedral grid
    refinement`, with the octahedron inside cut along its shortest diagonal).

    The vertices stay first, the midpoints of the edges follow; the children of tet i are 8 i to 8 i + 7.
    """
    tets, vertices = tissue.tets, tissue.vertices
    count = len(vertices)
    low, high = np.sort(tets[:, _EDGES].reshape(-1, 2), axis=1).T
    keys, owner = np.unique(low * count + high, return_inverse=True)
    edges = np.stack(np.divmod(keys, count), axis=1)
    middle = count + owner.reshape(-1, 6)
    fine = np.vstack([vertices, vertices[edges].mean(axis=1)])
    ab, ac, ad, bc, bd, cd = middle.T
    a, b, c, d = tets.T
    corners = [(a, ab, ac, ad), (ab, b, bc, bd), (ac, bc, c, cd), (ad, bd, cd, d)]
    shortest = np.argmin(
        [np.linalg.norm(fine[middle[:, i]] - fine[middle[:, j]], axis=1) for i, j in _DIAGONALS], axis=0
    )
    # about each diagonal the other four midpoints in order, so that the four tets are positively oriented
    rings = ((ab, cd, (ac, ad, bd, bc)), (ac, bd, (ad, ab, bc, cd)), (ad, bc, (ab, ac, cd, bd)))
    inner = []
    for i in range(4):
        choices = [(p, q, ring[i], ring[(i + 1) % 4]) for p, q, ring in rings]
        inner.append(tuple(np.choose(shortest, [choice[k] for choice in choices]) for k in range(4)))
    children = np.stack([np.stack(child, axis=1) for child in (*corners, *inner)], axis=1).reshape(-1, 4)

    def midpoint(i: IntArray, j: IntArray) -> IntArray:
        return count + np.searchsorted(keys, np.minimum(i, j) * count + np.maximum(i, j))

    p, q, r = tissue.skull_faces.T
    pq, qr, rp = midpoint(p, q), midpoint(q, r), midpoint(r, p)
    skull = np.stack([p, pq, rp, pq, q, qr, rp, qr, r, pq, qr, rp], axis=1).reshape(-1, 3)
    return Tissue(fine, children, skull)
