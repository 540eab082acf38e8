"""A warp of space that a few control points govern: radial basis functions (Botsch and Kobbelt 2005).

    d(x) = sum_j c_j ||x - p_j||^3 + A x + b,      d(p_j) = d_j

phi(r) = r^3 is triharmonic, so the warp is as smooth as interpolation gets; the linear part reproduces every affine
motion of the control points.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import RBFInterpolator

from retarget.check import InvalidInput, check_points
from retarget.types import FloatArray

FLAT = 0.1  # an extent of the control points below this share of their largest is none
APART = 1e-6  # of the largest extent: control points that are nearer have one place

Warp = Callable[[FloatArray], FloatArray]  # points (m, 3) mm -> displacements (m, 3) mm


def space_warp(points: FloatArray, displacements: FloatArray) -> Warp:
    """The displacement field through those of the control points (k, 3) mm, k > 0.

    The linear part needs four points that lie in no plane. Points in a plane therefore warp in the plane's two
    coordinates, and space moves along with its projection; points on a line in the one along it; a single point, or
    none apart, carries everything with it. Points within FLAT of a plane or a line count as lying on it, so that
    nothing is extrapolated from a hair's breadth.
    Raises InvalidInput for arrays that do not fit each other, and for points in one place that move differently.
    """
    moves = check_points("displacements", displacements, len(points), "control point")
    centre = points.mean(axis=0)
    _, extents, axes = np.linalg.svd(points - centre, full_matrices=False)
    hull = axes[extents > FLAT * extents[0]] if extents[0] > 0 else axes[:0]  # (d, 3)
    places = (points - centre) @ hull.T
    _check_apart(places, moves, extents[0])
    if not len(hull):
        return lambda x: np.tile(moves[0], (len(x), 1))
    field = RBFInterpolator(places, moves, kernel="cubic", degree=1)

    def warp(x: FloatArray) -> FloatArray:
        moved: FloatArray = field((x - centre) @ hull.T)
        return moved

    return warp


def _check_apart(places: FloatArray, moves: FloatArray, extent: float) -> None:
    near = np.linalg.norm(places[:, None] - places[None], axis=2) <= APART * max(extent, 1e-300)
    first, second = np.nonzero(np.triu(near, 1))
    if len(first):
        raise InvalidInput(
            f"control points: {first[0]} and {second[0]} (counted from 0) are in one place, as far as their warp can "
            f"tell, with displacements {moves[first[0]].tolist()} and {moves[second[0]].tolist()} mm; leave one out."
        )
