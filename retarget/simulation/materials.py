"""Artistic control of the tissue: stiffness by region, and gravity."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from retarget.anatomy.head import Head
from retarget.check import InvalidInput
from retarget.types import FloatArray

EARTH = (0.0, -9.81, 0.0)  # m/s^2, +y up


def region_stiffness(head: Head, factors: Mapping[str, float]) -> FloatArray:
    """(t,) factors of the tets' weights: each tet gets that of the region of the skin vertex nearest to its middle.

    Where regions overlap their factors multiply. Raises InvalidInput for an unknown region or a factor <= 0.
    """
    template = head.template
    per_vertex = np.ones(len(head.skin))
    for name, factor in factors.items():
        if name not in template.regions.vertices:
            known = ", ".join(sorted(template.regions.vertices))
            raise InvalidInput(f"stiffness: {name!r} is no region of this topology; it has {known}.")
        if not (np.isfinite(factor) and factor > 0):
            raise InvalidInput(f"stiffness[{name!r}]: expected a finite number > 0, got {factor}.")
        per_vertex[template.regions.vertices[name]] *= factor
    _, nearest = cKDTree(head.skin).query(head.vertices[template.tets].mean(axis=1))
    stiffness: FloatArray = per_vertex[nearest]
    return stiffness


def check_stiffness(stiffness: ArrayLike, count: int) -> FloatArray:
    """(count,) float64 factors > 0, given as one number or one for each tet; raises InvalidInput."""
    factors = np.broadcast_to(np.asarray(stiffness, dtype=np.float64), (count,))
    if not (np.isfinite(factors).all() and (factors > 0).all()):
        raise InvalidInput(f"stiffness: expected finite numbers > 0, one or one for each of {len(factors)} tets.")
    return factors


def check_gravity(name: str, gravity: ArrayLike) -> FloatArray:
    """(3,) float64, finite; raises InvalidInput."""
    vector = np.asarray(gravity, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InvalidInput(f"{name}: expected a vector (3,) of finite numbers, got {gravity!r}; see `weight_change`.")
    return vector


def weight_change(
    gravity: ArrayLike, recorded: ArrayLike = EARTH, density: float = 1000.0, shear_modulus: float = 5000.0
) -> FloatArray:
    """(3,) in 1/mm: what `gravity` (3,) in m/s^2 changes against the one that an expression was recorded under.

    The energy density of a tet of weight 1 is shear_modulus (Pa) times ||F - DG||^2, so the change enters the energy
    as density (kg/m^3) * change / shear_modulus. 5 kPa is of the order published for facial skin and fat.
    Raises InvalidInput for vectors of another shape or that are not finite.
    """
    change = check_gravity("gravity", gravity) - check_gravity("recorded", recorded)
    per_millimetre: FloatArray = change * density / shear_modulus / 1000.0
    return per_millimetre
