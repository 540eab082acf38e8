"""The Laplacian of a triangle mesh, and smoothing by heat."""

from __future__ import annotations

from collections.abc import Callable

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


def heat(vertices: FloatArray, faces: IntArray, width: float) -> Callable[[FloatArray], FloatArray]:
    """Smoothing of values (n,) over a mesh (n, 3) mm by heat that spreads to a standard deviation of `width` mm.

    Constants stay, and values stay between the smallest and the largest, whatever the mesh.
    """
    stiffness, mass = surface_energies(vertices, faces)
    factor = CholeskyFactor(sp.diags_array(mass) + width**2 / (2 * _STEPS) * stiffness, "heat")

    def smoothed(values: FloatArray) -> FloatArray:
        for _ in range(_STEPS):
            values = factor.solve(mass * values)
        return values

    return smoothed
