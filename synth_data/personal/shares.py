"""Fields over the skin between parts that are told what to do: the share of each vertex in a bone's or a lid's motion.

Harmonic fields have no extremes but the prescribed ones and run along the skin, not through the air between the lips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from retarget.geometry.cholesky import CholeskyFactor
from retarget.geometry.laplacian import Heat, surface_energies
from retarget.types import FloatArray, IntArray

LIPS_APART = 10.0  # mm that count as the distance between the lips
ALIKE, NEIGHBOURS = 4.5, 20  # mm over which the lining averages the skin before it; vertices


@dataclass(frozen=True)
class Skin:
    """The Laplacian of one neutral."""

    stiffness: sp.csr_array  # (n, n)
    mass: FloatArray  # (n,) mm^2

    def harmonic(self, values: FloatArray, blur: float = 0.0) -> FloatArray:
        """(n,) the harmonic field that meets values (n,), NaN where free; then heat of `blur` mm smooths all of it."""
        free = np.isnan(values)
        out = np.where(free, 0.0, values)
        inner = self.stiffness[free]
        factor = CholeskyFactor(inner[:, free] + 1e-9 * sp.diags_array(self.mass[free]), "share")
        out[free] = factor.solve(-np.asarray(inner[:, ~free] @ values[~free]))
        return self.blurred(out, blur) if blur else out

    def blurred(self, values: FloatArray, width: float) -> FloatArray:
        """Values (n,) or (n, c) after heat has spread to a standard deviation of `width` mm."""
        return self.blur(width)(values)

    def blur(self, width: float) -> Heat:
        return Heat(self.stiffness, self.mass, width)


def skin_of(vertices: FloatArray, faces: IntArray) -> Skin:
    """The operators on vertices (n, 3) mm with faces (f, 3)."""
    return Skin(*surface_energies(vertices, faces))


def carried(vertices: FloatArray, skin: IntArray, inner: IntArray, reach: float, lip: FloatArray) -> sp.csr_array:
    """(n, n): motion of the skin, taken along by what lies behind it, fading over `reach` mm of depth.

    lip (n,) is 0 on one lip and 1 on the other: the lining of one does not follow the other.
    """
    n = len(vertices)
    sided = np.column_stack([vertices, LIPS_APART * smoothstep(2.5 * lip - 0.75)])
    distance, near = cKDTree(sided[skin]).query(sided[inner], NEIGHBOURS)
    weight = np.exp(-0.5 * (distance**2 - distance[:, :1] ** 2) / ALIKE**2)
    weight *= np.exp(-0.5 * (distance[:, :1] / reach) ** 2) / weight.sum(axis=1, keepdims=True)
    rows, columns = np.concatenate([skin, np.repeat(inner, NEIGHBOURS)]), np.concatenate([skin, skin[near].ravel()])
    return sp.csr_array((np.concatenate([np.ones(len(skin)), weight.ravel()]), (rows, columns)), shape=(n, n))


def smoothstep(x: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, and smooth between."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3 - 2 * t)
