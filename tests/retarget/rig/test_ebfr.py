"""Example-based facial rigging: what it must reduce to, a literal second implementation, and both steps of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from retarget.check import InvalidInput
from retarget.geometry.triangles import deformation_gradients
from retarget.rig.blendshapes import Ridge
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.rig.ebfr import CHUNK, EbfrSettings, ExampleBasedRigging, blending_weights
from retarget.types import FloatArray
from tests.synthetic import ball, cranium, expressions, head

FACES = ball(2)[1]
GENERIC, OWN = head(1, 2), head(2, 2)
UNITS = 6
SHAPES = expressions(1, UNITS, 2)  # of the generic rig
TRUTH = expressions(2, UNITS, 2)  # the same of the character
WEIGHTS = np.random.default_rng(0).uniform(0, 1, (4, UNITS))
EXAMPLES = OWN + np.tensordot(WEIGHTS, TRUTH - OWN, axes=1)
SETTINGS = EbfrSettings(alternations=3)
weightings = pytest.mark.parametrize("weighting", list(Weighting))


def rigging(weighting: Weighting = Weighting.UNIFORM) -> ExampleBasedRigging:
    return ExampleBasedRigging(DeformationTransfer(GENERIC, OWN, FACES, cranium(2), weighting))


def error(shapes: FloatArray) -> float:
    """mm"""
    return float(np.linalg.norm(shapes - TRUTH, axis=-1).mean())


def change(neutral: FloatArray, shapes: FloatArray) -> FloatArray:
    """(s, f, 3, 3): Q - 1, not transposed."""
    return np.array([deformation_gradients(neutral, shape, FACES) - np.eye(3) for shape in shapes])


def literal_step_a(weights: FloatArray, beta: float, settings: EbfrSettings) -> FloatArray:
    """(f, s, 9): one stacked least-squares problem for each triangle."""
    generic, wanted = change(GENERIC, SHAPES), change(OWN, EXAMPLES)
    solved = np.empty((len(FACES), UNITS, 9))
    for f in range(len(FACES)):
        size = np.linalg.norm(generic[:, f].reshape(UNITS, 9), axis=1)
        hold = ((1 + size) / (settings.kappa + size)) ** settings.theta
        rows = np.vstack([weights, np.diag(np.sqrt(beta * hold))])
        right = np.vstack(
            [wanted[:, f].reshape(-1, 9), np.sqrt(beta * hold)[:, None] * generic[:, f].reshape(UNITS, 9)]
        )
        solved[f], *_ = np.linalg.lstsq(rows, right, rcond=None)
    return solved


@pytest.mark.parametrize("count", [4, UNITS + 5], ids=["fewer examples than blendshapes", "more"])
def test_step_a_is_the_least_squares_solution_of_each_triangle(count, monkeypatch):
    rng = np.random.default_rng(5)
    weights = rng.uniform(-0.2, 1, (count, UNITS))
    examples = OWN + np.tensordot(weights, TRUTH - OWN, axes=1) + rng.normal(0, 0.3, (count, 1, 3))
    monkeypatch.setitem(globals(), "EXAMPLES", examples)
    monkeypatch.setattr("retarget.rig.ebfr.TRIANGLES", 100)
    rig = rigging()
    generic = rig.generic(SHAPES, SETTINGS)
    once = rig.alternate(generic, examples, weights, replace(SETTINGS, alternations=1, beta_first=0.3))
    correct, _ = once.steps[0]
    found = change(GENERIC, SHAPES) + correct(weights, generic.yielding).transpose(0, 1, 3, 2)
    literal = literal_step_a(weights, 0.3, SETTINGS)
    np.testing.assert_allclose(found.reshape(UNITS, -1, 9).transpose(1, 0, 2), literal, atol=1e-9)


def test_one_triangle_by_hand():
    """One blendshape, one example at full weight: the mean of both gradients, weighted 1 and beta w."""
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces, anchors = np.array([[0, 1, 2]]), np.array([0])
    wide, high = rest * [1.5, 1, 1], rest * [1, 3.0, 1]
    rig = ExampleBasedRigging(DeformationTransfer(rest, rest, faces, anchors))
    settings = EbfrSettings(beta_first=0.5, alternations=1, gamma_last=1e-6, bounded=False)
    generic = rig.generic(wide[None], settings)
    stretch = np.sqrt(1.5) - 1  # of the fourth edge, n / sqrt(|n|)
    size = np.hypot(0.5, stretch)
    hold = 0.5 * ((1 + size) / (0.1 + size)) ** 2
    made = rig.rig(generic, high[None], settings, np.ones((1, 1)))
    x, y = 1 + hold * 0.5 / (1 + hold), 1 + 2.0 / (1 + hold)
    np.testing.assert_allclose(made.shapes[0], rest * [x, y, 1], atol=1e-12)
    moved, wanted = made.shapes[0] - rest, high - rest
    np.testing.assert_allclose(made.weights, [[np.vdot(moved, wanted) / np.vdot(moved, moved)]], atol=1e-4)


@weightings
def test_without_examples_it_is_deformation_transfer(weighting):
    rig = rigging(weighting)
    made = rig.rig(rig.generic(SHAPES, SETTINGS), EXAMPLES[:0], SETTINGS)
    np.testing.assert_array_equal(made.shapes, rig.transfer(SHAPES))
    assert made.weights.shape == (0, UNITS)


@weightings
@pytest.mark.parametrize("anchors", [cranium(2), np.empty(0, dtype=np.int64)], ids=["anchored", "free"])
def test_integrated_gradients_give_the_vertices_and_leave_in_place_what_is_still(weighting, anchors):
    transfer = DeformationTransfer(GENERIC, OWN, FACES, anchors, weighting)
    changes = change(OWN, TRUTH).transpose(0, 1, 3, 2)
    np.testing.assert_allclose(transfer.integrate(changes, SHAPES - GENERIC), TRUTH - OWN, atol=1e-9)


@weightings
def test_the_rigs_own_shapes_as_examples_give_the_rig(weighting):
    rig = rigging(weighting)
    generic = rig.generic(SHAPES, SETTINGS)
    free = EbfrSettings(beta_first=1e-12, beta_last=1e-12, alternations=2)
    np.testing.assert_allclose(rig.rig(generic, TRUTH, free, np.eye(UNITS)).shapes, TRUTH, atol=1e-6)
    held = rig.rig(generic, TRUTH, SETTINGS, np.eye(UNITS))
    assert error(held.shapes) < 0.6 * error(rig.transfer(SHAPES))
    np.testing.assert_allclose(held.weights, np.eye(UNITS), atol=0.15)


def test_blends_that_determine_the_rig_give_it_as_well():
    rig = rigging()
    weights = np.random.default_rng(3).uniform(0, 1, (2 * UNITS, UNITS))
    examples = OWN + np.tensordot(weights, TRUTH - OWN, axes=1)
    free = EbfrSettings(beta_first=1e-9, beta_last=1e-9, alternations=1)
    generic = rig.generic(SHAPES, free)
    made = rig.rig(generic, examples, free, weights).shapes
    # Gradients of blends are not quite blends of gradients: normals turn. What is left is that.
    assert error(made) < 0.05 * error(rig.transfer(SHAPES))


def test_more_examples_bring_the_rig_closer():
    rig = rigging()
    generic = rig.generic(SHAPES, SETTINGS)
    weights = np.random.default_rng(4).uniform(0, 1, (24, UNITS))
    examples = OWN + np.tensordot(weights, TRUTH - OWN, axes=1)
    errors = [error(rig.rig(generic, examples[:k], SETTINGS, weights[:k]).shapes) for k in (0, 3, 24)]
    assert errors[0] > errors[1] > errors[2]


def test_each_step_of_each_alternation_lowers_its_energy():
    rough = WEIGHTS + np.random.default_rng(1).normal(0, 0.15, WEIGHTS.shape)
    rough = rough.clip(0, 1)
    rig, n = rigging(), len(OWN)
    settings = EbfrSettings(alternations=5, gamma_first=20, gamma_last=1)
    generic = rig.generic(SHAPES, settings)
    done = rig.alternate(generic, EXAMPLES, rough, settings)
    wanted, wanted_moved = change(OWN, EXAMPLES), EXAMPLES - OWN
    first = change(GENERIC, SHAPES)

    def energy_a(gradients: FloatArray, weights: FloatArray, beta: float) -> float:
        fit = ((wanted - np.tensordot(weights, gradients, axes=1)) ** 2).sum()
        return float(fit + beta * (((gradients - first) ** 2).sum((2, 3)) / generic.yielding).sum())

    def energy_b(shapes: FloatArray, weights: FloatArray, gamma: float) -> float:
        fit = ((wanted_moved - np.tensordot(weights, shapes, axes=1)) ** 2).sum()
        return float(fit + gamma * n * ((weights - rough) ** 2).sum())

    weights, gradients = rough, first
    for number, ((correct, weigh), (beta, gamma)) in enumerate(zip(done.steps, settings.schedule(), strict=True)):
        better = first + correct(weights, generic.yielding).transpose(0, 1, 3, 2)
        assert energy_a(better, weights, beta) < energy_a(gradients, weights, beta), number
        gradients = better
        shapes = rig.corrected(generic, correct, weights)
        if weigh is not None:
            found = weigh(shapes, rough)
            assert energy_b(shapes, found, gamma.lambda_reg) < energy_b(shapes, weights, gamma.lambda_reg), number
            weights = found
    assert list(done.misfit) == sorted(done.misfit, reverse=True)


@pytest.mark.parametrize("bounded", [False, True])
def test_weights_are_optimal_and_follow_from_the_residuals(bounded):
    shapes, targets = TRUTH - OWN, EXAMPLES - OWN + np.random.default_rng(2).normal(0, 2, EXAMPLES.shape)
    targets[0] *= -1  # wants negative weights
    prior = np.full((4, UNITS), 0.4)
    ridge = Ridge(2.0)
    weights, again = blending_weights(shapes, targets, ridge, prior, bounded)
    strength = np.sqrt(2.0 * len(OWN))
    for j in range(4):
        rows = np.vstack([shapes.reshape(UNITS, -1).T, strength * np.eye(UNITS)])
        right = np.r_[targets[j].ravel(), strength * prior[j]]
        if bounded:  # 0 <= a <= 1: a by non-negative least squares with slacks that hold a + slack = 1
            stacked = np.block([[rows, np.zeros((len(rows), UNITS))], [1e7 * np.eye(UNITS), 1e7 * np.eye(UNITS)]])
            expected = nnls(stacked, np.r_[right, np.full(UNITS, 1e7)])[0][:UNITS]
        else:
            expected = np.linalg.lstsq(rows, right, rcond=None)[0]
        np.testing.assert_allclose(weights[j], expected, atol=1e-5)
    assert weights.min() < 0 or bounded
    np.testing.assert_allclose(again(shapes, prior), weights, atol=1e-9)


def test_blendshapes_that_are_not_used_weigh_nothing():
    used = np.arange(UNITS) != 2
    weights, _ = blending_weights(TRUTH - OWN, EXAMPLES - OWN, Ridge(0.1), used=used)
    without, _ = blending_weights((TRUTH - OWN)[used], EXAMPLES - OWN, Ridge(0.1))
    np.testing.assert_allclose(weights[:, used], without, atol=1e-12)
    assert not weights[:, 2].any()


@pytest.mark.parametrize("bounded", [False, True])
def test_a_blendshape_that_is_followed_becomes_what_it_became(bounded):
    settings = replace(SETTINGS, bounded=bounded, gamma_first=10, gamma_last=1)
    shapes = expressions(1, CHUNK + 3, 2)
    rig = rigging()
    generic = rig.generic(shapes, settings)
    prior, explain = blending_weights(generic.transferred, EXAMPLES - OWN, Ridge(1e-2), bounded=bounded)
    done = rig.alternate(generic, EXAMPLES, prior, settings)
    last, _ = done.steps[-1]
    became = rig.corrected(generic, last, done.weights)
    some = rig.generic(shapes[[4, 9]], settings)
    held = explain(some.transferred)
    np.testing.assert_allclose(held, prior[:, [4, 9]], atol=1e-9)
    np.testing.assert_allclose(done.follow(some, held), became[[4, 9]], atol=1e-8)
    still = rig.generic(GENERIC[None], settings)
    np.testing.assert_allclose(done.follow(still, explain(still.transferred)), 0, atol=1e-9)


def test_a_duplicate_example_and_one_equal_to_the_neutral_are_no_obstacle():
    rig = rigging()
    generic = rig.generic(SHAPES, SETTINGS)
    twice = np.concatenate([EXAMPLES[:2], EXAMPLES[:2], OWN[None]])
    made = rig.rig(generic, twice, SETTINGS)
    assert np.isfinite(made.shapes).all()
    np.testing.assert_allclose(made.weights[:2], made.weights[2:4], atol=1e-9)
    np.testing.assert_allclose(made.weights[4], 0, atol=1e-9)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"beta_last": 0}, "beta_last: expected a positive number, got 0"),
        ({"kappa": -1}, "kappa: expected a positive"),
        ({"theta": -1}, "theta: expected a number of at least 0"),
        ({"gamma_last": 0}, "lambda_reg: expected a positive"),
        ({"alternations": 0}, "alternations: expected a whole number of at least 1"),
        ({"residual": "means"}, "Did you mean 'mean'"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, words):
    with pytest.raises(InvalidInput, match=words):
        EbfrSettings(**wrong)


def test_arrays_that_do_not_fit_are_refused():
    rig = rigging()
    generic = rig.generic(SHAPES, SETTINGS)
    with pytest.raises(InvalidInput, match="weights: expected one for each of 4 examples and 6 blendshapes"):
        rig.rig(generic, EXAMPLES, SETTINGS, WEIGHTS[:, 1:])
    with pytest.raises(InvalidInput, match="examples: expected 162 vertices"):
        rig.rig(generic, EXAMPLES[:, 1:], SETTINGS)
    with pytest.raises(InvalidInput, match="shapes: expected 162 vertices"):
        rig.generic(SHAPES[:, 1:], SETTINGS)
