"""The quadratic energy that draws deformation gradients to given ones: eqs (A.5) and (A.6)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numba import njit, prange

from retarget.simulation.chunks import CHUNKS, gather
from retarget.simulation.tetrahedra import RestShape, gradient_operator
from retarget.types import FloatArray


class GradientEnergy:
    """E(x) = sum_t w_t ||F_t(x) - D_t||_F^2 = x^T A x - 2 x^T G^T W D + const, for weights (t,) with volumes."""

    def __init__(self, shape: RestShape, weights: FloatArray) -> None:
        self.shape, self.weights = shape, np.ascontiguousarray(weights, dtype=np.float64)
        tets = shape.tets  # in their own order: gradients are read and written in a row, which is what takes time
        self._tets = np.ascontiguousarray(tets, dtype=np.uint32)
        self._inverse = np.ascontiguousarray(shape.inverse).reshape(-1, 9)
        self._bounds = np.linspace(0, len(tets), CHUNKS + 1).astype(np.int64)
        chunks = [tets[a:b] for a, b in zip(self._bounds[:-1], self._bounds[1:], strict=True)]
        self._ranges = np.array([(c.min(), c.max() + 1) if len(c) else (0, 0) for c in chunks], dtype=np.int64)
        self._parts = np.empty((CHUNKS, len(shape.vertices), 3))

    def matrix(self) -> sp.csr_array:
        """A = G^T W G (n, n), half the energy's second derivative; one block for all three coordinates."""
        gradient = gradient_operator(self.shape)
        return sp.csr_array(gradient.T @ sp.diags_array(np.repeat(self.weights, 3)) @ gradient)

    def divergence(self, targets: FloatArray) -> FloatArray:
        """G^T W D (n, 3) for targets D (t, 3, 3). Not re-entrant: calls share one buffer."""
        wanted = np.ascontiguousarray(targets, dtype=np.float64).reshape(-1, 9)
        total = np.empty((len(self.shape.vertices), 3))
        _scatter(self._tets, self._inverse, self.weights, wanted, self._bounds, self._ranges, self._parts)
        gather(self._parts, self._ranges, total)
        return total

    def __call__(self, vertices: FloatArray, targets: FloatArray) -> tuple[float, FloatArray]:
        """E and the gradients F (t, 3, 3) at vertices (n, 3) mm, for targets D (t, 3, 3)."""
        x = np.ascontiguousarray(vertices, dtype=np.float64)
        wanted = np.ascontiguousarray(targets, dtype=np.float64).reshape(-1, 9)
        gradients, energies = np.empty_like(wanted), np.zeros(CHUNKS)
        _evaluate(x, self._tets, self._inverse, self.weights, wanted, self._bounds, gradients, energies)
        return float(energies.sum()), gradients.reshape(-1, 3, 3)


@njit(cache=True, parallel=True, fastmath={"contract", "reassoc"})
def _scatter(tets, inverse, weights, wanted, bounds, ranges, parts):  # type: ignore[no-untyped-def]
    for chunk in prange(len(bounds) - 1):
        parts[chunk, ranges[chunk, 0] : ranges[chunk, 1]] = 0.0
        for t in range(bounds[chunk], bounds[chunk + 1]):
            v0, v1, v2, v3, w = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3], weights[t]
            m0, m1, m2 = inverse[t, 0] * w, inverse[t, 1] * w, inverse[t, 2] * w
            m3, m4, m5 = inverse[t, 3] * w, inverse[t, 4] * w, inverse[t, 5] * w
            m6, m7, m8 = inverse[t, 6] * w, inverse[t, 7] * w, inverse[t, 8] * w
            for j in range(3):
                u, v, s = wanted[t, 3 * j], wanted[t, 3 * j + 1], wanted[t, 3 * j + 2]
                a = u * m0 + v * m1 + s * m2
                b = u * m3 + v * m4 + s * m5
                c = u * m6 + v * m7 + s * m8
                parts[chunk, v0, j] -= a + b + c
                parts[chunk, v1, j] += a
                parts[chunk, v2, j] += b
                parts[chunk, v3, j] += c


@njit(cache=True, parallel=True, fastmath={"contract", "reassoc"})  # NaN keeps its meaning
def _evaluate(x, tets, inverse, weights, wanted, bounds, gradients, energies):  # type: ignore[no-untyped-def]
    for chunk in prange(len(bounds) - 1):
        energy = 0.0
        for t in range(bounds[chunk], bounds[chunk + 1]):
            v0, v1, v2, v3 = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
            m0, m1, m2 = inverse[t, 0], inverse[t, 1], inverse[t, 2]
            m3, m4, m5 = inverse[t, 3], inverse[t, 4], inverse[t, 5]
            m6, m7, m8 = inverse[t, 6], inverse[t, 7], inverse[t, 8]
            squared = 0.0
            for j in range(3):
                a, b, c = x[v1, j] - x[v0, j], x[v2, j] - x[v0, j], x[v3, j] - x[v0, j]
                f0 = a * m0 + b * m3 + c * m6
                f1 = a * m1 + b * m4 + c * m7
                f2 = a * m2 + b * m5 + c * m8
                d0, d1, d2 = f0 - wanted[t, 3 * j], f1 - wanted[t, 3 * j + 1], f2 - wanted[t, 3 * j + 2]
                squared += d0 * d0 + d1 * d1 + d2 * d2
                gradients[t, 3 * j], gradients[t, 3 * j + 1], gradients[t, 3 * j + 2] = f0, f1, f2
            energy += weights[t] * squared
        energies[chunk] = energy
