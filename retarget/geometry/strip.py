"""Triangles across a loop, such as the opening between two lids."""

from __future__ import annotations

import numpy as np

from retarget.types import FloatArray, IntArray


def strip(vertices: FloatArray, loop: IntArray, corner: int) -> IntArray:
    """(m, 3) triangles between the two sides of a loop that meet at loop[0] and loop[corner].

    Walks both sides from loop[0] and always adds the triangle with the shorter new edge. Every triangle has corners
    on both sides; on the left of the face, where the loops start at the inner corner and run over the top, they face
    outward.
    """
    upper, lower = loop[: corner + 1], np.r_[loop[:1], loop[: corner - 1 : -1]]
    i, j, triangles = 0, 0, []
    while i < len(upper) - 1 or j < len(lower) - 1:
        on_upper = i + 1 < len(upper) and (
            j + 1 == len(lower)
            or np.linalg.norm(vertices[upper[i + 1]] - vertices[lower[j]])
            <= np.linalg.norm(vertices[lower[j + 1]] - vertices[upper[i]])
        )
        triangles.append((lower[j], upper[i + 1], upper[i]) if on_upper else (lower[j], lower[j + 1], upper[i]))
        i, j = (i + 1, j) if on_upper else (i, j + 1)
    return np.array([t for t in triangles if len(set(t)) == 3], dtype=np.int64)
