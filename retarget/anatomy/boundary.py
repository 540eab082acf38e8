"""The surface of a tetrahedral mesh."""

from __future__ import annotations

import numpy as np

from retarget.types import FloatArray, IntArray

OUTWARD = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # faces of a positively oriented tet, seen from outside


def boundary_faces(tets: IntArray) -> tuple[IntArray, IntArray]:
    """Triangles (b, 3) that belong to one tet only, facing away from it, and that tet's index (b,)."""
    faces = np.concatenate([tets[:, corners] for corners in OUTWARD])
    low, middle, high = np.sort(faces, axis=1).T
    count = int(tets.max()) + 1  # one number per triangle sorts far faster than rows do
    _, first, uses = np.unique((low * count + middle) * count + high, return_index=True, return_counts=True)
    alone = np.sort(first[uses == 1])
    return faces[alone], alone % len(tets)


def signed_volumes(vertices: FloatArray, tets: IntArray) -> FloatArray:
    """(t,) mm^3, positive for positively oriented tets."""
    origin = vertices[tets[:, 0]]
    a, b, c = (vertices[tets[:, i]] - origin for i in (1, 2, 3))
    volume: FloatArray = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    return volume


def enclosed_volume(vertices: FloatArray, faces: IntArray) -> float:
    """mm^3 inside a closed, outward surface."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
