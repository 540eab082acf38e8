"""Space warps by radial basis functions (section 3.3.2; Botsch and Kobbelt 2005): phi(r) = r^3, linear polynomial."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.interpolate import RBFInterpolator

from retarget.check import InvalidInput, check_vertices
from retarget.types import FloatArray, IntArray


def farthest_points(points: FloatArray, count: int, first: int = 0) -> IntArray:
    """(min(count, n),) indices into (n, 3) mm: each next point is the one farthest from those before.

    Stops early where only copies of points already taken are left.
    """
    taken = _farthest(np.ascontiguousarray(points), min(count, len(points)), first)
    return taken[taken >= 0]


@njit(cache=True)
def _farthest(points: FloatArray, count: int, first: int) -> IntArray:
    taken = np.full(count, -1, dtype=np.int64)
    nearest = np.full(len(points), np.inf)
    following = first
    for k in range(count):
        taken[k] = following
        x, y, z = points[following]
        farthest = 0.0
        for i in range(len(points)):
            distance = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2 + (points[i, 2] - z) ** 2
            nearest[i] = min(nearest[i], distance)
            if nearest[i] > farthest:
                farthest, following = nearest[i], i
        if farthest == 0.0:
            break
    return taken


def warp(sources: FloatArray, targets: FloatArray, smoothing: float = 0.0) -> RBFInterpolator:
    """The smoothest map of space that takes sources (c, 3) mm to targets (c, 3) mm; call it with points (p, 3) mm.

    Affine maps are reproduced. Raises InvalidInput for fewer than four points, or points in one plane.
    """
    sources, targets = check_vertices("warp sources", sources), check_vertices("warp targets", targets)
    if len(sources) != len(targets) or len(sources) < 4:
        raise InvalidInput(
            f"warp: expected at least 4 points and as many targets, got {len(sources)} and {len(targets)}."
        )
    try:
        return RBFInterpolator(sources, targets, kernel="cubic", degree=1, smoothing=smoothing)
    except np.linalg.LinAlgError as error:
        raise InvalidInput("warp: expected distinct points that do not lie in one plane, got others.") from error
