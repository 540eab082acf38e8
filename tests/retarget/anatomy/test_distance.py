"""Distances to closed surfaces whose answers are known."""

from __future__ import annotations

import numpy as np
import trimesh

from retarget.anatomy.distance import closest, signed_distance
from retarget.types import FloatArray

BOX = trimesh.creation.box((2.0, 2.0, 2.0))
SURFACE = np.array(BOX.vertices, dtype=np.float64), np.array(BOX.faces, dtype=np.int64)


def to_box(points: FloatArray) -> FloatArray:
    """The signed distance in closed form, positive inside."""
    over = np.abs(points) - 1.0
    outside: FloatArray = np.linalg.norm(np.maximum(over, 0), axis=1) + np.minimum(over.max(axis=1), 0)
    return -outside


def test_signed_distance_of_a_box_beyond_faces_edges_and_corners() -> None:
    points = np.random.default_rng(3).uniform(-2, 2, (500, 3))
    assert np.abs(signed_distance(SURFACE, points) - to_box(points)).max() < 1e-6


def test_closest_points_lie_on_the_box_at_that_distance() -> None:
    points = np.random.default_rng(4).uniform(-2, 2, (500, 3))
    found = closest(SURFACE, points)
    assert np.abs(np.abs(found).max(axis=1) - 1).max() < 1e-6
    assert np.abs(np.linalg.norm(points - found, axis=1) - np.abs(to_box(points))).max() < 1e-6
