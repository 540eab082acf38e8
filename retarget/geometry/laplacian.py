"""The Laplacian of a triangle mesh, and smoothing by heat."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from retarget.geometry.cholesky import CholeskyFactor
from retarget.types import FloatArray, IntArray

_STEPS = 2  # implicit steps of the heat; one alone has a cusp


def surface_energies(vertices: FloatArray, faces: IntArray) -> tuple[sp.csr_array, FloatArray]:
    """Stiffness (n, n) with weights (cot a + cot b) / 2 and the lumped areas (n,) in mm^2, for vertices (n, 3) mm.

    Negative cotangents are left out, so that what is smoothed has no new extremes.
    """
    n = len(vertices)
    stiffness, mass = sp.csr_array((n, n)), np.full(n, 1e-3)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        a, b = vertices[faces[:, i]] - vertices[faces[:, k]], vertices[faces[:, j]] - vertices[faces[:, k]]
        twice_area = np.linalg.norm(np.cross(a, b), axis=1)
        weight = np.clip(0.5 * np.einsum("ij,ij->i", a, b) / np.maximum(twice_area, 1e-9), 1e-3, 1e2)
        ends = faces[:, i], faces[:, j]
        stiffness = stiffness - sp.csr_array((weight, ends), shape=(n, n)) - sp.csr_array((weight, ends[::-1]), (n, n))
        mass += np.bincount(faces[:, k], twice_area / 6, n)
    return sp.csr_array(stiffness - sp.diags_array(stiffness.sum(axis=1))), mass


class Heat:
    """Smoothing by heat that spreads to a standard deviation of `width` mm, factorised once.

    Constants and the integral over the area stay, and values stay between the smallest and the largest.
    """

    def __init__(self, stiffness: sp.csr_array, mass: FloatArray, width: float) -> None:
        """stiffness (n, n) and mass (n,) mm^2: those of `surface_energies`."""
        self.mass = mass
        self._factor = CholeskyFactor(sp.diags_array(mass) + width**2 / (2 * _STEPS) * stiffness, "heat")

    def __call__(self, values: FloatArray) -> FloatArray:
        """Smoothed values (n,) or (n, c)."""
        mass = self.mass if values.ndim == 1 else self.mass[:, None]
        for _ in range(_STEPS):
            values = self._factor.solve(mass * values)
        return values


def heat(vertices: FloatArray, faces: IntArray, width: float) -> Heat:
    """Smoothing over a mesh (n, 3) mm, (f, 3), that spreads to `width` mm whatever its resolution."""
    return Heat(*surface_energies(vertices, faces), width)
