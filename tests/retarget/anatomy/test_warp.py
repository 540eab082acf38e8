"""Space warps: what they reproduce and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.anatomy.warp import farthest_points, warp
from retarget.check import InvalidInput


def test_affine_maps_are_reproduced() -> None:
    rng = np.random.default_rng(0)
    sources, points = rng.uniform(-100, 100, (60, 3)), rng.uniform(-150, 150, (200, 3))
    matrix, shift = np.eye(3) + 0.2 * rng.standard_normal((3, 3)), np.array([5.0, -30.0, 2.0])
    mapped = warp(sources, sources @ matrix.T + shift)(points)
    assert np.abs(mapped - (points @ matrix.T + shift)).max() < 1e-9


def test_the_warp_goes_through_its_points_and_solves_its_equations() -> None:
    rng = np.random.default_rng(1)
    sources = rng.uniform(-50, 50, (40, 3))
    targets = sources + rng.standard_normal((40, 3))
    points = rng.uniform(-60, 60, (25, 3))
    # by hand: sum_j w_j |x - c_j|^3 + a + B x, with weights orthogonal to affine functions
    cubes = np.linalg.norm(sources[:, None] - sources, axis=2) ** 3
    affine = np.column_stack([np.ones(40), sources])
    system = np.block([[cubes, affine], [affine.T, np.zeros((4, 4))]])
    weights = np.linalg.solve(system, np.vstack([targets, np.zeros((4, 3))]))
    by_hand = np.linalg.norm(points[:, None] - sources, axis=2) ** 3 @ weights[:40]
    by_hand += np.column_stack([np.ones(25), points]) @ weights[40:]
    found = warp(sources, targets)
    assert np.abs(found(sources) - targets).max() < 1e-8
    assert np.abs(found(points) - by_hand).max() < 1e-8


def test_farthest_points_halve_a_line() -> None:
    line = np.column_stack([np.arange(9.0), np.zeros(9), np.zeros(9)])
    assert farthest_points(line, 5).tolist() == [0, 8, 4, 2, 6]


def test_each_farthest_point_is_the_farthest() -> None:
    points = np.random.default_rng(2).standard_normal((200, 3))
    taken = farthest_points(points, 20)
    for k in range(1, 20):
        distance = np.linalg.norm(points[:, None] - points[taken[:k]], axis=2).min(axis=1)
        assert distance[taken[k]] == pytest.approx(distance.max())


def test_copies_are_taken_once() -> None:
    assert len(farthest_points(np.repeat(np.eye(3), 5, axis=0), 10)) == 3


def test_unfit_points_are_refused() -> None:
    with pytest.raises(InvalidInput, match="at least 4 points"):
        warp(np.eye(3), np.eye(3))
    flat = np.column_stack([np.random.default_rng(3).standard_normal((10, 2)), np.zeros(10)])
    with pytest.raises(InvalidInput, match="do not lie in one plane"):
        warp(flat, flat)
    with pytest.raises(InvalidInput, match="NaN"):
        warp(np.full((5, 3), np.nan), np.zeros((5, 3)))
