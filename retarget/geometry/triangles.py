"""Frames and deformation gradients of triangles (Sumner and Popovic 2004, section 3).

A triangle with edges e1 = v2 - v1 and e2 = v3 - v1 gets a fourth vertex v4 = v1 + n / sqrt(|n|), n = e1 x e2, so that
V = [e1, e2, v4 - v1] is invertible, its third column is normal to the triangle and grows like a length.
The deformation gradient of a triangle is Q = V' V^-1.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from retarget.types import FloatArray, IntArray


def edges(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    """e1 and e2 of each triangle; vertices (n, ..., 3) give two arrays (f, ..., 3) in the same unit."""
    origin = vertices[faces[:, 0]]
    return vertices[faces[:, 1]] - origin, vertices[faces[:, 2]] - origin


def fourth_edges(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """v4 - v1 = n / sqrt(|n|); vertices (n, ..., 3) give (f, ..., 3). A collapsed triangle gets its limit, zero."""
    normal = np.cross(*edges(vertices, faces))
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    fourth: FloatArray = normal / np.sqrt(np.where(length > 0, length, 1.0))
    return fourth


def areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(f,) triangle areas."""
    twice: FloatArray = np.linalg.norm(np.cross(*edges(vertices, faces)), axis=-1)
    return 0.5 * twice


def frames(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(f, 3, 3) matrices V with the columns e1, e2 and v4 - v1."""
    return np.stack([*edges(vertices, faces), fourth_edges(vertices, faces)], axis=-1)


def deformation_gradients(rest: FloatArray, deformed: FloatArray, faces: IntArray) -> FloatArray:
    """(f, 3, 3) gradients Q = V' V^-1, without unit, that map the rest triangles to the deformed ones."""
    return frames(deformed, faces) @ np.linalg.inv(frames(rest, faces))


def gradient_operators(vertices: FloatArray, faces: IntArray) -> tuple[sp.csr_array, sp.csr_array]:
    """The gradient of a deformation as two sparse matrices over this rest shape, in 1/mm.

    Returns G (3f, n) and N (3f, f), such that the rows 3j, 3j+1, 3j+2 of ``G @ x + N @ fourth_edges(x, faces)``
    hold the transposed deformation gradient of triangle j for deformed vertices x (n, 3). ``G @ u`` alone is the
    gradient of the piecewise linear function u, which lies in the plane of each triangle.
    """
    n, f = len(vertices), len(faces)
    dual = np.linalg.inv(frames(vertices, faces))  # rows: gradients of the hat functions of v2, v3 and v4
    hats = np.stack([-dual[:, 0] - dual[:, 1], dual[:, 0], dual[:, 1]], axis=-1)  # (f, direction, corner)
    rows = np.arange(3 * f).reshape(f, 3)
    gradient = sp.csr_array((hats.ravel(), (np.repeat(rows, 3), np.repeat(faces, 3, axis=0).ravel())), shape=(3 * f, n))
    normal = sp.csr_array((dual[:, 2].ravel(), (rows.ravel(), np.repeat(np.arange(f), 3))), shape=(3 * f, f))
    return gradient, normal
