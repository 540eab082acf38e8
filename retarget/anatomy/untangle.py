"""Repair of inverted and nearly flat tets by moving few vertices (Garanzha et al. 2021, Foldover-free maps in 50 lines
of code, doi:10.1145/3450626.3459847)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import minimize

from retarget.simulation.tetrahedra import RestShape, edges, hat_gradients
from retarget.types import FloatArray, IntArray

FLAT = 0.1  # a tet whose volume falls below this share of its rest volume is repaired
_VOLUME = 0.5  # weight of the volume term against the shape term
_ANCHOR = 2.0  # 1/mm^2: weight of a skin vertex' distance from its place against a tet of mean volume
_RINGS = 2  # of tets about the bad ones that take part
_ROUNDS = 10  # of lowering the regularisation
_ITERATIONS = 40  # of L-BFGS in a round


@dataclass(frozen=True)
class Repair:
    """What `untangle` did."""

    vertices: FloatArray  # (m, 3) mm
    inverted: int  # tets before
    before: int  # tets at or below `FLAT` before
    after: int


def volume_ratios(shape: RestShape, vertices: FloatArray) -> FloatArray:
    """(t,) det F: the signed volume of each tet at vertices (m, 3) mm over that at rest."""
    ratios: FloatArray = np.linalg.det(edges(vertices, shape.tets)) / (6000.0 * shape.volumes)
    return ratios


def untangle(shape: RestShape, vertices: FloatArray, operator: sp.csr_array, targets: FloatArray) -> Repair:
    """Move vertices (m, 3) mm near bad tets until every volume ratio exceeds `FLAT`, or as far as that goes.

    operator (n, m) @ vertices stays near targets (n, 3) mm. Vertices away from bad tets keep their bits.
    """
    ratios = volume_ratios(shape, vertices)
    inverted, before = int((ratios <= 0).sum()), int((ratios <= FLAT).sum())
    x = vertices
    for rings in range(1, _RINGS + 1):
        bad = ratios <= FLAT
        if not bad.any():
            break
        x = _relax(shape, x, bad, operator, targets, rings)
        ratios = volume_ratios(shape, x)
    return Repair(x, inverted, before, int((ratios <= FLAT).sum()))


def _relax(
    shape: RestShape,
    x: FloatArray,
    bad: NDArray[np.bool_],
    operator: sp.csr_array,
    targets: FloatArray,
    rings: int,
) -> FloatArray:
    inside = np.zeros(len(x), dtype=bool)
    inside[shape.tets[bad]] = True
    for _ in range(rings):
        inside[shape.tets[inside[shape.tets].any(axis=1)]] = True
    free = np.flatnonzero(inside)
    near = np.flatnonzero(inside[shape.tets].any(axis=1))
    slot = np.full(len(x), -1)
    slot[free] = np.arange(len(free))
    tets, slots = shape.tets[near], slot[shape.tets[near]]
    hats = hat_gradients(shape)[near]
    weight = shape.volumes[near] / shape.volumes[near].mean()
    columns = operator[:, free]
    rows = np.flatnonzero(np.diff(columns.indptr))
    columns, anchors = sp.csr_array(columns[rows]), targets[rows] - operator[rows] @ x
    start = x[free]
    moved = x.copy()

    def energy(flat: FloatArray, epsilon: float) -> tuple[float, FloatArray]:
        moved[free] = flat.reshape(-1, 3)
        off = columns @ (moved[free] - start) - anchors
        gradient = 2 * _ANCHOR * (columns.T @ off)
        value = fold_energy(moved, tets, slots, hats, weight, epsilon, gradient)
        return value + _ANCHOR * float((off**2).sum()), gradient.ravel()

    for _ in range(_ROUNDS):
        lowest = volume_ratios(shape, moved)[near].min()
        epsilon = float(np.sqrt(1e-8 + 0.04 * min(lowest - FLAT, 0.0) ** 2))
        found = minimize(
            energy, moved[free].ravel(), (epsilon,), "L-BFGS-B", jac=True, options={"maxiter": _ITERATIONS}
        )
        moved[free] = found.x.reshape(-1, 3)
        if volume_ratios(shape, moved)[near].min() > FLAT:
            break
    return moved


@njit(cache=True)
def fold_energy(
    x: FloatArray,
    tets: IntArray,
    slots: IntArray,
    hats: FloatArray,
    weight: FloatArray,
    epsilon: float,
    gradient: FloatArray,
) -> float:
    """The energy of Garanzha et al., eq. (3), whose gradient is added to `gradient` (free, 3)."""
    total = 0.0
    for t in range(len(tets)):
        f = np.zeros((3, 3))
        for c in range(4):
            for i in range(3):
                for j in range(3):
                    f[i, j] += x[tets[t, c], i] * hats[t, c, j]
        cofactor = np.empty((3, 3))
        squares = 0.0
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            cofactor[i, 0] = f[a, 1] * f[b, 2] - f[a, 2] * f[b, 1]
            cofactor[i, 1] = f[a, 2] * f[b, 0] - f[a, 0] * f[b, 2]
            cofactor[i, 2] = f[a, 0] * f[b, 1] - f[a, 1] * f[b, 0]
            squares += f[i, 0] ** 2 + f[i, 1] ** 2 + f[i, 2] ** 2
        det = f[0, 0] * cofactor[0, 0] + f[0, 1] * cofactor[0, 1] + f[0, 2] * cofactor[0, 2]
        root = np.sqrt(epsilon * epsilon + det * det)
        chi = 0.5 * (det + root) if det > 0 else 0.5 * epsilon * epsilon / (root - det)
        slope = chi / root
        form = squares / chi ** (2.0 / 3.0)
        volume = (det * det + 1) / chi
        total += weight[t] * (form + _VOLUME * volume)
        by_f = weight[t] * 2 / chi ** (2.0 / 3.0)
        by_det = weight[t] * (-(2.0 / 3.0) * form / chi * slope + _VOLUME * (2 * det - volume * slope) / chi)
        for c in range(4):
            s = slots[t, c]
            if s >= 0:
                for i in range(3):
                    for j in range(3):
                        gradient[s, i] += (by_f * f[i, j] + by_det * cofactor[i, j]) * hats[t, c, j]
    return total
