"""Space warps by radial basis functions (section 3.3.2; Botsch and Kobbelt 2005): phi(r) = r^3, linear polynomial."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator

from retarget.check import InvalidInput, check_vertices
from retarget.types import FloatArray, IntArray


def farthest_points(points: FloatArray, count: int, first: int = 0) -> IntArray:
    """(min(count, n),) indices into (n, 3) mm: each next point is the one farthest from those before.

    Stops early where only copies of points already taken are left.
    """
    taken = [first]
    distance = np.sum((points - points[first]) ** 2, axis=1)
    while len(taken) < count:
        following = int(np.argmax(distance))
        if distance[following] <= 0:
            break
        taken.append(following)
        np.minimum(distance, np.sum((points - points[following]) ** 2, axis=1), out=distance)
    return np.array(taken, dtype=np.int64)


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
