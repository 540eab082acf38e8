"""Lips and lids that touch but do not cross: two facing sheets, each a height over the same plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from retarget.types import FloatArray

REACH = 2.5  # mm in the plane within which two sheets face each other
SPREAD = 2.0  # mm over which a push fades in its sheet
PASSES = 3


@dataclass(frozen=True)
class Contact:
    """Two sheets whose overlap may not grow beyond that at rest and `gap`."""

    upper: FloatArray  # (a,) mm of overlap at rest of each vertex of the upper sheet, below zero where apart
    lower: FloatArray  # (b,)
    gap: float  # mm

    def __call__(
        self, upper: tuple[FloatArray, FloatArray], lower: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Heights (a,) and (b,) mm to add, for (plane (a, 2), height (a,)) mm and the same of the lower sheet."""
        (plane_up, up), (plane_low, low) = upper, lower
        lift, sink = np.zeros(len(up)), np.zeros(len(low))
        for _ in range(PASSES):
            over = overlaps((plane_up, up + lift), (plane_low, low - sink))
            excess = [
                np.maximum(now - np.maximum(rest, -self.gap), 0.0)
                for now, rest in zip(over, (self.upper, self.lower), strict=True)
            ]
            if not (excess[0].any() or excess[1].any()):
                break
            lift += 0.5 * (_spread(plane_up, plane_up, excess[0]) + _spread(plane_up, plane_low, excess[1])) * 0.75
            sink += 0.5 * (_spread(plane_low, plane_low, excess[1]) + _spread(plane_low, plane_up, excess[0])) * 0.75
        return lift, -sink


def overlaps(
    upper: tuple[FloatArray, FloatArray], lower: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """(a,), (b,) mm by which each vertex of a sheet passes the other one, very negative where none is opposite."""
    (plane_up, up), (plane_low, low) = upper, lower
    return _opposite(plane_up, plane_low, low) - up, low - _opposite(plane_low, plane_up, up, sign=-1.0)


def rest(upper: tuple[FloatArray, FloatArray], lower: tuple[FloatArray, FloatArray], gap: float) -> Contact:
    """The contact of two sheets at rest."""
    return Contact(*overlaps(upper, lower), gap)


def _opposite(plane: FloatArray, other: FloatArray, height: FloatArray, sign: float = 1.0) -> FloatArray:
    """(m,) height of the other sheet at places (m, 2), so far away where it is out of reach that nothing touches."""
    distance, near = cKDTree(other).query(plane, 4)
    weight = 1 / (distance + 0.2) ** 2
    found = np.sum(weight * height[near], axis=1) / weight.sum(axis=1)
    return np.where(distance[:, 0] < REACH, found, -sign * 1e6)


def _spread(to: FloatArray, of: FloatArray, excess: FloatArray) -> FloatArray:
    """(m,) the largest excess about each place, faded with distance."""
    touching = np.flatnonzero(excess)
    if len(touching) == 0:
        return np.zeros(len(to))
    fade = np.exp(-0.5 * cdist(to, of[touching], "sqeuclidean") / SPREAD**2)
    return np.asarray((fade * excess[touching]).max(axis=1))
