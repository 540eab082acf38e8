"""Triangles drawn to a wanted area: the projective form of eqs (A.2) and (A.3).

# differs from the paper: (A - a)^2 carries length^4, so its weight would mean another thing on every mesh. Minimised is
    sum_f w A_f min { ||F_f - D||^2 : the singular values of D have the product a_f / A_f },
with the gradient F_f (3, 2) of triangle f in the plane of its neutral shape, its neutral area A_f in cm^2 and w per cm:
a triangle resists a wrong area as w cm of tissue on it would resist strain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numba import njit

from retarget.geometry.triangles import areas, edges
from retarget.types import FloatArray, IntArray

MM2_PER_CM2 = 100.0
DEGENERATE = 1e-6  # of the squared longest edge: areas below have no plane to measure a gradient in


@dataclass(frozen=True)
class AreaTerms:
    """Rows 2i and 2i+1 of ``operator @ points`` are the transposed gradient of triangle kept[i]."""

    kept: IntArray  # (k,) triangles that are not degenerate at rest
    operator: sp.csr_array  # (2 k, n) in 1/mm
    weights: FloatArray  # (k,) cm^2


def area_terms(vertices: FloatArray, triangles: IntArray) -> AreaTerms:
    """For neutral vertices (n, 3) mm and triangles (f, 3). Those that are degenerate at rest get no term."""
    area = areas(vertices, triangles)
    first, second = edges(vertices, triangles)
    longest = np.maximum((first**2).sum(axis=1), (second**2).sum(axis=1))
    kept = np.flatnonzero(area > DEGENERATE * longest)
    first, second, triangles = first[kept], second[kept], triangles[kept]
    length = np.linalg.norm(first, axis=1)
    along = np.einsum("fi,fi->f", first, second) / length
    rest = np.zeros((len(kept), 2, 2))  # edges in an orthonormal basis of the plane, in columns
    rest[:, 0, 0], rest[:, 0, 1], rest[:, 1, 1] = length, along, 2 * area[kept] / length
    dual = np.linalg.inv(rest)  # rows: gradients of the hat functions of the second and third corner
    hats = np.stack([-dual.sum(axis=1), dual[:, 0], dual[:, 1]], axis=-1)  # (k, direction, corner)
    rows = np.repeat(np.arange(2 * len(kept)), 3)
    columns = np.repeat(triangles, 2, axis=0).ravel()
    operator = sp.csr_array((hats.ravel(), (rows, columns)), shape=(2 * len(kept), len(vertices)))
    return AreaTerms(kept, operator, area[kept] / MM2_PER_CM2)


def project(gradients: FloatArray, ratios: FloatArray) -> FloatArray:
    """(2 k, 3): closest transposed gradients whose singular values have the product ratios (k,) >= 0.

    A fast `projections.closest_area`, which it is tested against.
    """
    projected = np.empty_like(gradients)
    _project(gradients, ratios, projected)
    return projected


@njit(cache=True)
def _project(gradients, ratios, projected):  # type: ignore[no-untyped-def]
    for k in range(len(ratios)):
        g, h = gradients[2 * k], gradients[2 * k + 1]
        # Singular values and right vectors from the 2 x 2 Gram matrix [[a, b], [b, c]].
        a, b, c = (g * g).sum(), (g * h).sum(), (h * h).sum()
        angle = 0.5 * np.arctan2(2 * b, a - c)
        cos, sin = np.cos(angle), np.sin(angle)
        first, second = cos * g + sin * h, cos * h - sin * g  # F v_1 and F v_2
        s1 = np.sqrt((first * first).sum())
        if s1 > 0:
            first /= s1
            second -= (second * first).sum() * first
        else:
            first[0], first[1], first[2] = 1.0, 0.0, 0.0
        s2 = np.sqrt((second * second).sum())
        if s2 > 1e-12 * s1:
            second /= s2
        else:  # any direction normal to the first
            axis = np.argmin(np.abs(first))
            second[:] = -first[axis] * first
            second[axis] += 1
            second /= np.sqrt((second * second).sum())
            s2 = 0.0
        d1, d2 = _closest_product(s1, s2, ratios[k])
        projected[2 * k] = cos * d1 * first - sin * d2 * second
        projected[2 * k + 1] = sin * d1 * first + cos * d2 * second


@njit(cache=True)
def _closest_product(s1, s2, ratio):  # type: ignore[no-untyped-def]
    """The d >= 0 with d_1 d_2 = ratio closest to s_1 >= s_2 >= 0; see `projections.closest_area`."""
    if s1 <= 0:
        return np.sqrt(ratio), np.sqrt(ratio)
    low, high, nu = -s2 / s1, 1.0, 0.0
    for _ in range(60):  # Newton, kept in a bracket by bisection
        rest = 1 - nu * nu
        value = (s1 + nu * s2) * (s2 + nu * s1) - ratio * rest * rest
        slope = s1 * s1 + s2 * s2 + 2 * nu * s1 * s2 + 4 * ratio * nu * rest
        if value < 0:
            low = nu
        else:
            high = nu
        step = value / slope if slope > 0 else np.inf
        if abs(step) < 1e-15:
            break
        nu -= step
        if not low < nu < high:
            nu = 0.5 * (low + high)
            if high - low < 1e-16:
                break
    scale = 1 - nu * nu
    if 1 + nu < 1e-9:  # equal sides above twice the root of the ratio
        root = np.sqrt(max(s1 * s1 - 4 * ratio, 0.0))
        return 0.5 * (s1 + root), 0.5 * (s1 - root)
    if scale < 1e-12:
        return np.sqrt(ratio), np.sqrt(ratio)
    return (s1 + nu * s2) / scale, (s2 + nu * s1) / scale
