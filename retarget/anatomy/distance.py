"""Distances from points to closed triangle surfaces."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from retarget.types import FloatArray, IntArray

Surface = tuple[FloatArray, IntArray]  # (n, 3) mm, (f, 3)


def closest(surface: Surface, points: FloatArray) -> FloatArray:
    """(m, 3) mm: the points of the triangles closest to points (m, 3) mm."""
    _, found = _mesh(surface).find_closest_cell(points, return_closest_point=True)  # type: ignore[misc]  # a pair
    return np.asarray(found, dtype=np.float64).reshape(points.shape)


def distance_to(surface: Surface, points: FloatArray) -> FloatArray:
    """(m,) mm from points (m, 3) to the triangles of a surface."""
    result: FloatArray = np.linalg.norm(points - closest(surface, points), axis=1)
    return result


def signed_distance(surface: Surface, points: FloatArray) -> FloatArray:
    """(m,) mm from points (m, 3) to a closed surface that faces outward, positive inside.

    The sign is that of the angle-weighted pseudonormal (Baerentzen and Aanaes 2005), so it is right at edges too.
    """
    cloud = pv.PolyData(np.ascontiguousarray(points)).compute_implicit_distance(_mesh(surface))
    outward: FloatArray = np.asarray(cloud["implicit_distance"], dtype=np.float64)
    return -outward


def _mesh(surface: Surface) -> pv.PolyData:
    return pv.PolyData.from_regular_faces(surface[0], surface[1])  # type: ignore[arg-type]  # its stub wants int
