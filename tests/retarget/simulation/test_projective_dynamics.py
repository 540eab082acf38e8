import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp

from retarget.check import InvalidInput
from retarget.geometry.cholesky import NotPositiveDefinite
from retarget.simulation import projective_dynamics
from retarget.simulation.anderson import Anderson
from retarget.simulation.projections import closest_rotation, closest_unit_determinant, unit_product
from retarget.simulation.projective_dynamics import (
    ProjectiveDynamics,
    SolverSettings,
    TissueWeights,
    tissue_weights,
)
from retarget.simulation.tetrahedra import deformation_gradients, gradient_operator, rest_shape
from retarget.types import Status
from tests.retarget.simulation.box import box
from tests.retarget.simulation.threads import with_one_and_two_threads

EXACT = SolverSettings(max_iterations=500, energy_tolerance=1e-13, step_tolerance=1e-9, single_precision=False)


@pytest.fixture(scope="module")
def slab():
    """Skin on top, skull below, muscle in the lower half; 40 x 40 x 10 mm."""
    vertices, tets = box((10, 10, 4), (40.0, 40.0, 10.0))
    shape = rest_shape(vertices, tets)
    skull = np.flatnonzero(vertices[:, 2] == 0)
    skin = np.flatnonzero(vertices[:, 2] == 10)
    operator = sp.csr_array((np.ones(len(skin)), (np.arange(len(skin)), skin)), shape=(len(skin), len(vertices)))
    muscle = vertices[tets].mean(axis=1)[:, 2] < 5
    return shape, muscle, skull, operator, vertices[skin]


def bulge(skin, height=3.0):
    return skin + np.exp(-((skin[:, :2] - 20) ** 2).sum(axis=1) / 60)[:, None] * [0.5 * height, 0, height]


def solver(slab, settings=None, **changes):
    shape, muscle, skull, operator, _ = slab
    return ProjectiveDynamics(shape, tissue_weights(shape, muscle), skull, operator, settings=settings, **changes)


def test_the_neutral_target_gives_the_neutral(slab):
    shape, *_, skin = slab
    result = solver(slab).solve(skin)
    assert result.info.status is Status.CONVERGED
    assert result.info.iterations == 1
    np.testing.assert_allclose(result.vertices, shape.vertices, atol=1e-12)
    disturbed = shape.vertices + 0.2 * np.random.default_rng(0).normal(size=shape.vertices.shape)
    result = solver(slab, EXACT).solve(skin, start=disturbed)
    np.testing.assert_allclose(result.vertices, shape.vertices, atol=1e-6)


@pytest.mark.parametrize("depth", [0, 5])
def test_the_energy_never_rises_and_the_history_is_whole(slab, depth):
    *_, skin = slab
    settings = SolverSettings(anderson_depth=depth)
    problem = solver(slab, settings)
    result = problem.solve(bulge(skin, 8.0))
    assert result.info.status is Status.CONVERGED
    energy = np.array(result.info.energy)
    assert len(energy) == result.info.iterations + 1 == len(result.rms_steps) + 1
    assert (np.diff(energy) <= 0).all()
    assert energy[-2] - energy[-1] <= settings.energy_tolerance * energy[-2]
    assert result.rms_steps[-1] <= settings.step_tolerance
    assert problem.energy_and_descent(result.vertices, bulge(skin, 8.0))[0] == energy[-1]


@pytest.mark.parametrize("pushed", [False, True])
def test_a_last_step_that_is_not_evaluated_is_bounded(slab, pushed):
    """Its energy lies below what is reported, by as much again at most; the rest of the history is the same."""
    shape, *_, skin = slab
    forces = 1e-4 * np.sin(shape.vertices) if pushed else None
    whole = SolverSettings(energy_tolerance=1e-3, single_precision=False, anderson_depth=0)
    results = []
    for settings in (whole, dataclasses.replace(whole, bounded_end=True)):
        problem = solver(slab, settings)
        calls, evaluate = [], problem._evaluate
        problem._evaluate = lambda *a, calls=calls, evaluate=evaluate: calls.append(0) or evaluate(*a)
        results.append((problem.solve(bulge(skin, 8.0), forces=forces), len(calls)))
    (plain, _), (found, evaluations) = results
    assert found.info.status is Status.CONVERGED
    assert evaluations == found.info.iterations < len(found.info.energy)
    common = found.info.iterations
    np.testing.assert_allclose(found.info.energy[:common], plain.info.energy[:common])
    *_, before, reported = found.info.energy
    true = solver(slab, whole).energy_and_descent(found.vertices, bulge(skin, 8.0), forces)[0]
    assert 2 * reported - before - 1e-9 * abs(before) <= true <= reported < before
    assert before - true <= whole.energy_tolerance * before + 1e-9
    assert found.rms_steps[-1] <= whole.step_tolerance


def test_acceleration_finds_the_same_minimum_in_fewer_iterations(slab):
    *_, skin = slab
    results = [solver(slab, dataclasses.replace(EXACT, anderson_depth=d)).solve(bulge(skin)) for d in (0, 5)]
    np.testing.assert_allclose(results[0].vertices, results[1].vertices, atol=1e-4)
    assert results[1].info.iterations < 0.5 * results[0].info.iterations


def test_a_plain_iteration_solves_for_the_closest_matrices(slab):
    """Its vertices minimise the energy with R, D and s held: least squares, assembled here without the solver."""
    shape, muscle, skull, operator, skin = slab
    weights, wanted = tissue_weights(shape, muscle), bulge(skin, 6.0)
    start = shape.vertices + 0.3 * np.random.default_rng(0).normal(size=shape.vertices.shape)
    start[skull] = shape.vertices[skull]
    settings = dataclasses.replace(EXACT, max_iterations=1, anderson_depth=0)
    result = solver(slab, settings).solve(wanted, start=start)

    gradients = deformation_gradients(shape, start)
    rows, right = [np.sqrt(100.0 / 10**2) * operator], [np.sqrt(100.0 / 10**2) * wanted]
    for weight, closest in (
        (weights.strain, closest_rotation(gradients)),
        (weights.volume, closest_unit_determinant(gradients)),
    ):
        root = np.repeat(np.sqrt(weight), 3)[:, None]
        rows.append(gradient_operator(shape).multiply(root))
        right.append(root * np.swapaxes(closest, 1, 2).reshape(-1, 3))
    matrix = sp.csr_array(sp.vstack(rows))
    free = np.setdiff1d(np.arange(len(start)), skull)
    known = np.vstack(right) - matrix[:, skull] @ shape.vertices[skull]
    expected = np.linalg.lstsq(matrix[:, free].toarray(), known, rcond=None)[0]
    np.testing.assert_allclose(result.vertices[free], expected, atol=1e-7)


@pytest.mark.parametrize("poison", [lambda step: -3 * step, lambda step: 50 * step, lambda step: np.nan * step])
def test_a_proposal_that_ascends_gives_way_to_the_plain_iterate(slab, monkeypatch, poison):
    """Whatever acceleration proposes, the solve takes the path of plain projective dynamics, and says so."""

    class Poisoned:
        restarts = 0

        def __init__(self, depth):
            pass

        def __call__(self, state, residual):
            return poison(residual)

        def restart(self):
            Poisoned.restarts += 1

    *_, skin = slab
    settings = dataclasses.replace(EXACT, max_iterations=6)
    plain = solver(slab, dataclasses.replace(settings, anderson_depth=0)).solve(bulge(skin))
    monkeypatch.setattr(projective_dynamics, "Anderson", Poisoned)
    guarded = solver(slab, settings).solve(bulge(skin))
    assert guarded.info == plain.info
    np.testing.assert_array_equal(guarded.vertices, plain.vertices)
    assert Poisoned.restarts == 6


def test_the_minimum_is_stationary(slab):
    _, _, skull, operator, skin = slab
    problem = solver(slab, EXACT)
    result = problem.solve(bulge(skin))
    _, start = problem.energy_and_descent(slab[0].vertices, bulge(skin))
    _, end = problem.energy_and_descent(result.vertices, bulge(skin))
    assert np.abs(end[problem.free]).max() < 1e-6 * np.abs(start).max()
    np.testing.assert_array_equal(result.vertices[skull], slab[0].vertices[skull])
    assert np.abs(operator @ result.vertices - bulge(skin)).max() < 0.5


def test_the_gradient_of_the_whole_energy(slab):
    shape, _, skull, _, skin = slab
    problem = solver(slab, EXACT)
    rng = np.random.default_rng(0)
    x, forces = shape.vertices + rng.normal(size=shape.vertices.shape), rng.normal(size=shape.vertices.shape)
    direction = rng.normal(size=shape.vertices.shape)
    direction[skull] = 0
    h = 1e-4
    ahead, behind = (problem.energy_and_descent(x + s * h * direction, skin, forces)[0] for s in (1, -1))
    descent = problem.energy_and_descent(x, skin, forces)[1]
    assert -2 * np.vdot(descent, direction) == pytest.approx((ahead - behind) / (2 * h), rel=1e-6)
    np.testing.assert_array_equal(descent[skull], 0)


def test_patch_test():
    """A homogeneous deformation of the boundary continues into the interior, exactly."""
    vertices, tets = box((4, 4, 4), (20.0, 20.0, 20.0))
    shape = rest_shape(vertices, tets)
    boundary = np.flatnonzero(((vertices == 0) | (vertices == 20)).any(axis=1))
    moved = vertices @ np.array([[1.1, 0.1, 0], [0, 0.95, 0.05], [0.1, 0, 1.05]]).T
    weights = TissueWeights(shape.volumes, shape.volumes)
    result = ProjectiveDynamics(shape, weights, boundary, settings=EXACT).solve(fixed_positions=moved[boundary])
    np.testing.assert_allclose(result.vertices, moved, atol=1e-6)


def test_a_manufactured_solution_converges_with_the_square_of_the_mesh_size():
    """phi = (X + u(X), Y, Z) with u = a sin(k X), held by targets s = phi - 100 div P / (2 c) at every vertex.

    F = diag(1 + u', 1, 1), so R = I, D = diag(d), and only P_11 = 2 (F_11 - 1) + 2 (F_11 - d_1) has a divergence.
    """
    length, a, c = 20.0, 0.6, 3.0
    k = 2 * np.pi / length

    def stress(x):
        stretch = 1 + a * k * np.cos(k * x)
        order = np.argsort(-np.stack([stretch, np.ones_like(x), np.ones_like(x)], axis=1), axis=1, kind="stable")
        sigma = np.take_along_axis(np.stack([stretch, np.ones_like(x), np.ones_like(x)], axis=1), order, axis=1)
        d = unit_product(sigma)[order == 0]
        return 2 * (stretch - 1) + 2 * (stretch - d)

    errors = []
    for cells in (4, 8, 16):
        vertices, tets = box((cells,) * 3, (length,) * 3)
        shape = rest_shape(vertices, tets)
        exact = vertices + np.c_[a * np.sin(k * vertices[:, 0]), np.zeros((len(vertices), 2))]
        h = 1e-4
        divergence = (stress(vertices[:, 0] + h) - stress(vertices[:, 0] - h)) / (2 * h)
        targets = exact - np.c_[100 * divergence / (2 * c), np.zeros((len(vertices), 2))]
        lumped = np.bincount(tets.ravel(), np.repeat(shape.volumes / 4, 4))
        boundary = np.flatnonzero(((vertices == 0) | (vertices == length)).any(axis=1))
        problem = ProjectiveDynamics(
            shape, TissueWeights(shape.volumes, shape.volumes), boundary, sp.eye_array(len(vertices)), c * lumped, EXACT
        )
        result = problem.solve(targets, exact[boundary])
        errors.append(np.sqrt(lumped @ ((result.vertices - exact) ** 2).sum(axis=1) / lumped.sum()))
    assert errors[-1] < 0.01
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (rates > 1.8).all(), (errors, rates)


def test_a_warm_start_reaches_the_same_minimum_sooner(slab):
    *_, skin = slab
    problem = solver(slab)
    before = problem.solve(bulge(skin, 3.0)).vertices
    cold, warm = problem.solve(bulge(skin, 3.2)), problem.solve(bulge(skin, 3.2), start=before)
    assert warm.info.iterations < cold.info.iterations
    np.testing.assert_allclose(warm.vertices, cold.vertices, atol=0.05)


@pytest.mark.parametrize("near", [False, True])
def test_the_start_extends_a_translation_exactly(slab, near):
    """Fixed vertices and targets go together: the harmonic extension is the translation, and nothing is left to do."""
    shape, _, skull, _, skin = slab
    shift = np.array([5.0, -3.0, 40.0])
    neighbour = (shape.vertices + 2 * shift, skin + 2 * shift) if near else None
    result = solver(slab, EXACT).solve(skin + shift, shape.vertices[skull] + shift, near=neighbour)
    np.testing.assert_allclose(result.vertices, shape.vertices + shift, atol=1e-9)
    assert result.info.energy[0] < 1e-12


def test_soft_constraints_have_their_own_weights(slab):
    shape, muscle, skull, operator, skin = slab
    pull = np.full(len(skin), 1e-9)
    pull[60] = 100.0
    wanted = skin + np.array([0, 0, 2.0])
    result = ProjectiveDynamics(shape, tissue_weights(shape, muscle), skull, operator, pull).solve(wanted)
    lifted = (operator @ result.vertices - skin)[:, 2]
    assert 1 < lifted[60] < 2
    assert np.abs(np.delete(lifted, [49, 59, 60, 61, 71, 48, 72, 50, 70])).max() < 0.7 * lifted[60]


def test_same_result_for_any_number_of_threads(slab):
    *_, skin = slab
    one, two = with_one_and_two_threads(lambda: solver(slab).solve(bulge(skin)))
    np.testing.assert_array_equal(one.vertices, two.vertices)
    assert one.info == two.info


@pytest.mark.parametrize("spoil", ["nan", "mirror", "collapse"])
def test_a_hopeless_start_fails_without_nan(slab, spoil):
    shape, *_, skin = slab
    start = {"nan": np.nan, "mirror": [1, 1, -1], "collapse": 0}[spoil] * shape.vertices
    result = solver(slab).solve(skin, start=start)
    assert result.info.status is Status.FAILED
    assert result.info.message == "start: not finite" if spoil == "nan" else "inverted or flat" in result.info.message
    assert np.isfinite(result.info.energy).all()
    np.testing.assert_array_equal(result.vertices, shape.vertices)


def test_an_inverted_start_can_be_repaired(slab):
    shape, *_, skin = slab
    start = shape.vertices + 2.5 * np.random.default_rng(0).normal(size=shape.vertices.shape)
    assert solver(slab).solve(skin, start=start).info.status is Status.FAILED
    result = solver(slab, dataclasses.replace(EXACT, repair_inverted_start=True)).solve(skin, start=start)
    assert result.info.status is Status.CONVERGED
    assert result.inverted == 0
    np.testing.assert_allclose(result.vertices, shape.vertices, atol=1e-5)


def test_too_few_iterations_are_reported(slab):
    *_, skin = slab
    result = solver(slab, SolverSettings(max_iterations=2)).solve(bulge(skin))
    assert result.info.status is Status.MAX_ITERATIONS
    assert result.info.iterations == 2


def test_nothing_that_holds_the_mesh_is_refused(slab):
    shape, muscle, *_ = slab
    with pytest.raises(NotPositiveDefinite, match="1 of 1 connected pieces are held by nothing"):
        ProjectiveDynamics(shape, tissue_weights(shape, muscle))


def test_the_weights_of_soft_and_muscle_tissue(slab):
    """Eq. (14): soft tissue resists strain and change of volume alike, muscle little but change of volume."""
    shape, muscle, *_ = slab
    weights = tissue_weights(shape, muscle, w_soft=2.0, w_muscle=3.0, muscle_strain=0.1)
    volume = 4 * 4 * 2.5 / 6 / 1000  # cm^3, a sixth of a cell
    np.testing.assert_allclose(weights.strain[~muscle], 2 * volume)
    np.testing.assert_allclose(weights.volume[~muscle], 2 * volume)
    np.testing.assert_allclose(weights.strain[muscle], 0.3 * volume)
    np.testing.assert_allclose(weights.volume[muscle], 3 * volume)


def test_external_forces_lift_what_they_pull(slab):
    """At the minimum the reaction of targets and tissue balances them: the gradient vanishes with the forces in it."""
    shape, *_, skin = slab
    forces = np.zeros_like(shape.vertices)
    forces[:, 2] = 1e-4
    problem = solver(slab, EXACT)
    result = problem.solve(skin, forces=forces)
    assert (result.vertices - shape.vertices)[problem.free, 2].min() > 0
    _, descent = problem.energy_and_descent(result.vertices, skin, forces)
    assert np.abs(descent).max() < 1e-6 * forces.max()


class Overshooting:
    """A factor whose solutions are `times` too long."""

    def __init__(self, factor, times):
        self.factor, self.times = factor, times

    def solve(self, rhs):
        return self.times * self.factor.solve(rhs)


def test_a_plain_step_that_raises_the_energy_fails(slab):
    shape, *_, skin = slab
    problem = solver(slab)
    problem._factor = Overshooting(problem._factor, -1.0)
    result = problem.solve(bulge(skin), start=shape.vertices)
    assert result.info.status is Status.FAILED
    assert "a plain step raised the energy by" in result.info.message
    np.testing.assert_array_equal(result.vertices, shape.vertices)


@pytest.mark.parametrize("single_precision", [True, False])
def test_rounding_ends_a_solve_without_tolerance(slab, single_precision):
    *_, skin = slab
    endless = dataclasses.replace(
        EXACT, energy_tolerance=1e-300, step_tolerance=1e-300, single_precision=single_precision
    )
    result = solver(slab, endless).solve(bulge(skin))
    assert result.info.status is Status.CONVERGED
    assert (np.diff(result.info.energy) <= 0).all()


def test_bad_input_is_refused(slab):
    shape, muscle, skull, operator, skin = slab
    weights = tissue_weights(shape, muscle)
    with pytest.raises(InvalidInput, match="muscle: expected one flag"):
        tissue_weights(shape, muscle[1:])
    with pytest.raises(InvalidInput, match="no unique shape"):
        tissue_weights(shape, muscle, muscle_strain=0.0)
    with pytest.raises(InvalidInput, match="fixed: expected vertex indices"):
        ProjectiveDynamics(shape, weights, [len(shape.vertices)])
    with pytest.raises(InvalidInput, match="at least one free vertex"):
        ProjectiveDynamics(shape, weights, np.arange(len(shape.vertices)))
    with pytest.raises(InvalidInput, match="target_operator: expected"):
        ProjectiveDynamics(shape, weights, skull, operator[:, 1:])
    with pytest.raises(InvalidInput, match="target_weights: expected finite"):
        ProjectiveDynamics(shape, weights, skull, operator, -1.0)
    with pytest.raises(InvalidInput, match=r"weights\.strain"):
        ProjectiveDynamics(shape, TissueWeights(-weights.strain, weights.volume), skull)
    problem = solver(slab)
    with pytest.raises(InvalidInput, match="targets: expected finite numbers, but 1 of"):
        problem.solve(np.where(np.arange(len(skin))[:, None] == 3, np.nan, skin))
    with pytest.raises(InvalidInput, match="fixed_positions"):
        problem.solve(skin, skin[:3])
    with pytest.raises(InvalidInput, match="start: expected"):
        problem.solve(skin, start=skin)
    with pytest.raises(InvalidInput, match="max_iterations"):
        SolverSettings(max_iterations=0)
    with pytest.raises(InvalidInput, match="energy_tolerance"):
        SolverSettings(energy_tolerance=0)


def test_anderson_solves_a_linear_fixed_point_of_dimension_m_in_m_plus_one_steps():
    """On an affine map it is GMRES (Walker and Ni 2011, theorem 2.2)."""
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    matrix = basis * [0.9, 0.5, -0.3, 0.1] @ basis.T
    accelerate, x = Anderson(5), rng.normal(size=(4, 1))
    for _ in range(6):
        x = x + accelerate(x, matrix @ x + 1 - x)
    np.testing.assert_allclose(x, np.linalg.solve(np.eye(4) - matrix, np.ones((4, 1))), atol=1e-5)
