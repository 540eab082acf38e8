"""Repair of inverted tets: the energy's gradient, what moves and what does not."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from retarget.anatomy.untangle import FLAT, fold_energy, untangle, volume_ratios
from retarget.simulation.tetrahedra import RestShape, hat_gradients, rest_shape
from retarget.types import FloatArray
from tests.retarget.simulation.box import box


@pytest.fixture
def shape() -> RestShape:
    return rest_shape(*box((6, 6, 6), (60.0, 60.0, 60.0)))


def folded(shape: RestShape) -> tuple[FloatArray, int]:
    """The box with the vertex in its middle pushed through its neighbours."""
    x = shape.vertices.copy()
    middle = int(np.argmin(np.linalg.norm(x - 30.0, axis=1)))
    x[middle] += [14.0, 3.0, 0.0]
    return x, middle


def test_ratios_are_determinants(shape: RestShape) -> None:
    matrix = np.array([[1.2, 0.3, 0], [0, 0.8, 0.1], [0.2, 0, -1.1]])
    assert volume_ratios(shape, shape.vertices @ matrix.T) == pytest.approx(np.linalg.det(matrix))


@pytest.mark.parametrize("epsilon", [1e-4, 1.0])
def test_the_gradient_is_that_of_finite_differences(shape: RestShape, epsilon: float) -> None:
    x = shape.vertices + np.random.default_rng(0).normal(0, 4.0, shape.vertices.shape)  # some tets are inverted
    near = np.flatnonzero((shape.tets == 100).any(axis=1))
    if epsilon < 1:  # without regularisation only where nothing is inverted
        x = shape.vertices + np.random.default_rng(0).normal(0, 0.5, shape.vertices.shape)
    slots = np.where(shape.tets[near] == 100, 0, -1)
    hats, weights = hat_gradients(shape)[near], np.linspace(1, 2, len(near))

    def energy(position: FloatArray) -> tuple[float, FloatArray]:
        moved, gradient = x.copy(), np.zeros((1, 3))
        moved[100] = position
        return fold_energy(moved, shape.tets[near], slots, hats, weights, epsilon, gradient), gradient[0]

    steps = 1e-5 * np.eye(3)
    differences = [(energy(x[100] + s)[0] - energy(x[100] - s)[0]) / 2e-5 for s in steps]
    assert energy(x[100])[1] == pytest.approx(np.array(differences), rel=1e-5)


def test_a_folded_box_is_unfolded_and_the_rest_stays(shape: RestShape) -> None:
    x, _ = folded(shape)
    nothing = sp.csr_array((0, len(x)))
    repair = untangle(shape, x, nothing, np.empty((0, 3)))
    assert repair.inverted == (volume_ratios(shape, x) <= 0).sum() > 0
    assert repair.after == 0
    assert volume_ratios(shape, repair.vertices).min() > FLAT
    far = np.abs(shape.vertices - 30.0).max(axis=1) > 25
    assert np.array_equal(repair.vertices[far], x[far])


def test_what_needs_no_repair_is_returned_to_the_bit(shape: RestShape) -> None:
    x = shape.vertices * [1.1, 0.9, 1.0]
    repair = untangle(shape, x, sp.eye_array(len(x), format="csr"), np.zeros_like(x))
    assert np.array_equal(repair.vertices, x)
    assert (repair.inverted, repair.before, repair.after) == (0, 0, 0)


def test_an_anchored_vertex_stays_nearer_to_its_target(shape: RestShape) -> None:
    x, middle = folded(shape)
    row = sp.csr_array(([1.0], ([0], [middle])), shape=(1, len(x)))
    loose = untangle(shape, x, sp.csr_array((0, len(x))), np.empty((0, 3)))
    tied = untangle(shape, x, row, x[[middle]])
    assert loose.after == tied.after == 0
    off = [np.linalg.norm(repair.vertices[middle] - x[middle]) for repair in (loose, tied)]
    assert off[1] < 0.5 * off[0]
