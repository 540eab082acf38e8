"""Rest shape of a tetrahedral mesh: volumes and the operator from vertices to deformation gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numba import njit, prange
from numpy.typing import ArrayLike

from retarget.check import InvalidInput, check_vertices
from retarget.types import FloatArray, IntArray

MM3_PER_CM3 = 1000.0


@dataclass(frozen=True)
class RestShape:
    """What the energies know of the rest state; made by `rest_shape`."""

    tets: IntArray  # (t, 4), positively oriented
    vertices: FloatArray  # (n, 3) mm
    inverse: FloatArray  # (t, 3, 3) 1/mm: inverse of the rest edges [v1 - v0, v2 - v0, v3 - v0], in columns
    volumes: FloatArray  # (t,) cm^3: true volumes, so that total stiffness does not depend on the mesh size


def edges(vertices: FloatArray, tets: IntArray) -> FloatArray:
    """(t, 3, 3) matrices with the columns v1 - v0, v2 - v0 and v3 - v0, in the unit of the vertices."""
    corners = vertices[tets]
    return np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)


def rest_shape(vertices: ArrayLike, tets: ArrayLike, relative: float = 1e-9) -> RestShape:
    """The rest shape of vertices (n, 3) mm and tets (t, 4).

    Raises InvalidInput for indices that do not fit, and for tets that are inverted or flat: signed volume at most
    `relative` times the cube of their longest edge at v0.
    """
    v = check_vertices("rest vertices", vertices)
    t = np.asarray(tets)
    if t.ndim != 2 or t.shape[1] != 4 or not np.issubdtype(t.dtype, np.integer) or len(t) == 0:
        raise InvalidInput(
            f"tets: expected at least one, of shape (t, 4) with integer indices, got {t.shape} of {t.dtype}."
        )
    if t.min() < 0 or t.max() >= len(v):
        raise InvalidInput(
            f"tets: indices reach from {t.min()} to {t.max()}, expected 0 to {len(v) - 1}; they belong to another mesh."
        )
    t = t.astype(np.int64)
    rest = edges(v, t)
    volume: FloatArray = np.linalg.det(rest) / 6
    bad = np.flatnonzero(volume <= relative * np.linalg.norm(rest, axis=1).max(axis=1) ** 3)
    if len(bad):
        raise InvalidInput(
            f"tets: {len(bad)} of {len(t)} have zero or negative volume at rest, the first is tet {bad[0]} with "
            f"{volume[bad[0]]:.3g} mm^3 and the vertices {t[bad[0]].tolist()}. Expected positively oriented tets; "
            "drop slivers, swap two vertices of inverted tets, or repair the warp that made them."
        )
    inverse = np.asarray(np.linalg.inv(rest), dtype=np.float64)
    return RestShape(t, v, inverse, volume / MM3_PER_CM3)


def vertex_volumes(shape: RestShape) -> FloatArray:
    """(n,) cm^3: a quarter of the tets about each vertex."""
    quarters = np.repeat(shape.volumes / 4, 4)
    return np.asarray(np.bincount(shape.tets.ravel(), quarters, len(shape.vertices)), dtype=np.float64)


def deformation_gradients(shape: RestShape, vertices: FloatArray) -> FloatArray:
    """(t, 3, 3) deformation gradients F, without unit, of vertices (n, 3) mm: F maps rest edges to deformed ones."""
    gradients = np.empty((len(shape.tets), 3, 3))
    _gradients(np.ascontiguousarray(vertices, dtype=np.float64), shape.tets, shape.inverse, gradients)
    return gradients


@njit(cache=True, parallel=True)
def _gradients(x, tets, inverse, gradients):  # type: ignore[no-untyped-def]
    for t in prange(len(tets)):
        v0, v1, v2, v3 = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
        for j in range(3):
            a, b, c = x[v1, j] - x[v0, j], x[v2, j] - x[v0, j], x[v3, j] - x[v0, j]
            for k in range(3):
                gradients[t, j, k] = a * inverse[t, 0, k] + b * inverse[t, 1, k] + c * inverse[t, 2, k]


@njit(cache=True)
def count_inverted(x, tets):  # type: ignore[no-untyped-def]
    """How many tets (t, 4) of vertices x (n, 3) have no positive volume."""
    count = 0
    for t in range(len(tets)):
        o, a, b, c = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
        u0, u1, u2 = x[a, 0] - x[o, 0], x[a, 1] - x[o, 1], x[a, 2] - x[o, 2]
        v0, v1, v2 = x[b, 0] - x[o, 0], x[b, 1] - x[o, 1], x[b, 2] - x[o, 2]
        w0, w1, w2 = x[c, 0] - x[o, 0], x[c, 1] - x[o, 1], x[c, 2] - x[o, 2]
        volume = u0 * (v1 * w2 - v2 * w1) + u1 * (v2 * w0 - v0 * w2) + u2 * (v0 * w1 - v1 * w0)
        if not volume > 0:
            count += 1
    return count


def hat_gradients(shape: RestShape) -> FloatArray:
    """(t, 4, 3) in 1/mm: the gradient of each corner's hat function, so that F = sum_c x_c hat_c^T."""
    return np.concatenate([-shape.inverse.sum(axis=1, keepdims=True), shape.inverse], axis=1)


def gradient_operator(shape: RestShape) -> sp.csr_array:
    """G (3t, n) in 1/mm: the rows 3j, 3j+1, 3j+2 of ``G @ x`` hold the transposed deformation gradient of tet j."""
    t, n = len(shape.tets), len(shape.vertices)
    hats = np.swapaxes(hat_gradients(shape), 1, 2)  # (t, direction, corner)
    rows = np.repeat(np.arange(3 * t), 4)
    columns = np.repeat(shape.tets, 3, axis=0)
    return sp.csr_array((hats.ravel(), (rows, columns.ravel())), shape=(3 * t, n))
