"""Lips of which one stays above the other: gaps between triangles, linear in what moves up and down.

What moves along the vertical alone stays in its column, so gaps are least at a corner of a triangle or where two edges
cross, seen from above, and displacements that keep them open are a quadratic programme.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from retarget.geometry.cholesky import CholeskyFactor
from retarget.types import FloatArray, IntArray, Regions

LOOK = 3.0  # mm by which lips may have passed each other
STIFFNESS = 1e5  # of contact, relative to the skin: 0.01 mm of the gap are lost
ROUNDS, SETTLED = 40, 1e-3  # of the contact's active set; mm of change that end them


def missing_gaps(at: FloatArray, upper: IntArray, lower: IntArray, gap: float) -> tuple[sp.csr_array, FloatArray]:
    """Rows (c, n) that give how gaps between points (n, 3) mm above each other grow, and what (c,) each lacks of `gap`.

    Coordinates are across, up and ahead; upper (a, 3) and lower (b, 3) are the triangles of either lip.
    """
    plane, height = at[:, [0, 2]], at[:, 1]
    one, other = _facing(upper, lower, plane, height, gap)
    indices, weights = [], []
    for corner in range(3):
        for points, triangles, sign in ((one, other, 1.0), (other, one, -1.0)):
            point = points[:, corner]
            share = _barycentric(plane[point], plane[triangles])
            inside = (share >= 0).all(axis=1)
            indices.append(np.column_stack([point, triangles])[inside])
            weights.append(sign * np.column_stack([np.ones(len(point)), -share])[inside])
    for i in range(3):
        for j in range(3):
            ends = np.column_stack([one[:, [i, (i + 1) % 3]], other[:, [j, (j + 1) % 3]]])
            s, t = _meet(*(plane[ends[:, k]] for k in range(4)))
            inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
            indices.append(ends[inside])
            weights.append(np.column_stack([1 - s, s, t - 1, -t])[inside])
    index, weight = np.concatenate(indices), np.concatenate(weights)
    rows = sp.csr_array(
        (weight.ravel(), (np.repeat(np.arange(len(index)), 4), index.ravel())), shape=(len(index), len(at))
    )
    return rows, gap - np.asarray(rows @ height)


def compliance(stiffness: sp.csr_array, mass: FloatArray, free: IntArray, smooth: float) -> FloatArray:
    """(k, k): how far vertices `free` give way to forces on each other, with motions that fade over `smooth` mm.

    stiffness (n, n) and mass (n,) mm^2 are those of `retarget.geometry.laplacian.surface_energies`.
    """
    screened = sp.diags_array(mass) + smooth**2 * stiffness
    energy = sp.csr_array(screened @ sp.diags_array(1 / mass) @ screened)
    return np.asarray(np.linalg.inv(energy[free][:, free].toarray()))


def least(compliance: FloatArray, rows: sp.csr_array, missing: FloatArray) -> FloatArray:
    """(k,) mm: the u of least energy with rows (c, k) @ u >= missing (c,), by Newton's method on the contact's penalty.

    Forces act where contact is active; it is found again in each round.
    """
    u, active = np.zeros(len(compliance)), missing > 0
    for _ in range(ROUNDS):
        touching = rows[active]
        reach = np.asarray(touching @ compliance)
        if touching.shape[0] < len(u):
            yielding = np.asarray(touching @ reach.T) + np.eye(len(reach)) / STIFFNESS
            before, u = u, cho_solve(cho_factor(yielding), missing[active]) @ reach
        else:  # the same, with as many unknowns as vertices
            yielding = np.asarray(touching.T @ reach).T + np.eye(len(u)) / STIFFNESS
            before, u = u, np.linalg.solve(yielding, missing[active] @ reach)
        now = missing > rows @ u
        if (now == active).all() or np.abs(u - before).max() < SETTLED:
            break
        active = now
    return u


def sides(stiffness: sp.csr_array, regions: Regions) -> FloatArray:
    """(n,) 0 on the upper lip and 1 on the lower one, harmonic between and over the lining of the mouth."""
    upper, lower = regions.vertices["upper_lip"], regions.vertices["lower_lip"]
    values = np.full(stiffness.shape[0], np.nan)
    values[np.setdiff1d(upper, lower)], values[np.setdiff1d(lower, upper)] = 0.0, 1.0
    free = np.isnan(values)
    inner = sp.csr_array(stiffness[free])
    factor = CholeskyFactor(sp.csc_array(inner[:, free] + 1e-9 * sp.eye_array(int(free.sum()))), "lips")
    values[free] = factor.solve(-np.asarray(inner[:, ~free] @ values[~free]))
    return values


def _facing(
    upper: IntArray, lower: IntArray, plane: FloatArray, height: FloatArray, gap: float
) -> tuple[IntArray, IntArray]:
    """Pairs of triangles (p, 3), (p, 3) that overlap seen from above and are near each other in height."""
    near: NDArray[np.bool_] = np.ones((len(upper), len(lower)), dtype=bool)
    for values, slack in ((plane[:, 0], 0.0), (plane[:, 1], 0.0), (height, LOOK)):
        of_upper, of_lower = values[upper], values[lower]
        near &= of_upper.min(axis=1)[:, None] <= of_lower.max(axis=1) + (gap if slack else 0.0)
        near &= of_lower.min(axis=1) <= of_upper.max(axis=1)[:, None] + slack
    one, other = np.nonzero(near)
    first, second = upper[one], lower[other]
    apart = ~(first[:, :, None] == second[:, None]).any(axis=(1, 2))
    return first[apart], second[apart]


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
