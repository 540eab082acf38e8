"""The space warp against what triharmonic interpolation with a linear part must do."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.geometry.space_warp import space_warp

RNG = np.random.default_rng(0)
SPREAD = RNG.normal(size=(7, 3)) * [20, 10, 8]
ANYWHERE = RNG.normal(size=(40, 3)) * 30


def test_it_passes_through_the_control_points() -> None:
    moves = RNG.normal(size=SPREAD.shape)
    np.testing.assert_allclose(space_warp(SPREAD, moves)(SPREAD), moves, atol=1e-9)


def test_affine_motions_of_the_control_points_carry_all_of_space() -> None:
    linear, shift = RNG.normal(size=(3, 3)), np.array([1.0, -2.0, 3.0])
    warp = space_warp(SPREAD, SPREAD @ linear + shift)
    np.testing.assert_allclose(warp(ANYWHERE), ANYWHERE @ linear + shift, atol=1e-8)


def test_it_is_the_sum_of_cubes_and_a_linear_part() -> None:
    """The system written down and solved a second time."""
    moves = RNG.normal(size=SPREAD.shape)
    cubes = np.linalg.norm(SPREAD[:, None] - SPREAD[None], axis=2) ** 3
    linear = np.column_stack([np.ones(len(SPREAD)), SPREAD])
    system = np.block([[cubes, linear], [linear.T, np.zeros((4, 4))]])
    c = np.linalg.solve(system, np.vstack([moves, np.zeros((4, 3))]))
    at = np.linalg.norm(ANYWHERE[:, None] - SPREAD[None], axis=2) ** 3
    expected = at @ c[:-4] + np.column_stack([np.ones(len(ANYWHERE)), ANYWHERE]) @ c[-4:]
    np.testing.assert_allclose(space_warp(SPREAD, moves)(ANYWHERE), expected, atol=1e-6)


@pytest.mark.parametrize("flat", [0.0, 1e-3])
def test_points_in_a_plane_warp_in_the_plane(flat: float) -> None:
    """Also nearly so: off the plane nothing is extrapolated."""
    plane = SPREAD * [1, 1, flat]
    moves = RNG.normal(size=SPREAD.shape)
    warp = space_warp(plane, moves)
    np.testing.assert_allclose(warp(plane), moves, atol=1e-9)
    above = warp(plane + np.array([0, 0, 5]))
    assert np.abs(above - moves).max() < 0.05


def test_points_on_a_line_warp_along_it_and_one_point_carries_everything() -> None:
    line = np.array([[0.0, 0, 0], [10, 0, 0]])
    warp = space_warp(line, np.array([[0.0, 0, 0], [0, 2, 0]]))
    np.testing.assert_allclose(warp(np.array([[5.0, 40, -3]])), [[0, 1, 0]], atol=1e-9)
    np.testing.assert_allclose(space_warp(line[:1], np.array([[1.0, 2, 3]]))(ANYWHERE), np.tile([1, 2, 3], (40, 1)))


def test_points_in_one_place_are_refused() -> None:
    with pytest.raises(InvalidInput, match=r"0 and 2 .* in one place"):
        space_warp(SPREAD[[0, 1, 0, 3, 4]], np.zeros((5, 3)))
