import numpy as np
import pytest
import scipy.sparse as sp

from retarget.simulation.area_terms import project
from retarget.simulation.condensed import CondensedSystem, SoftProblem, SoftRows, SoftSystem
from retarget.types import Status
from tests.retarget.geometry.test_cholesky import grid_laplacian

N = 225


def rows(rng, count, points, largest=10.0):
    return SoftRows(
        sp.random_array((count, points), density=0.3, rng=rng, format="csr"), rng.uniform(0.1, largest, count)
    )


@pytest.fixture(params=[20, 300])
def system(request):
    """Fewer and more points than vertices that they hang on."""
    rng = np.random.default_rng(0)
    matrix = grid_laplacian(15)
    points = sp.random_array((request.param, N), density=0.02, rng=rng, format="csr")
    return matrix, CondensedSystem.of(matrix, points, "grid", "cholespy")


def test_the_compliance(system):
    matrix, condensed = system
    expected = condensed.points @ np.linalg.solve(matrix.toarray(), condensed.points.T.toarray())
    np.testing.assert_allclose(condensed.compliance, expected, atol=1e-9)
    forces = np.random.default_rng(3).normal(size=(len(expected), 3))
    np.testing.assert_allclose(condensed.shifts(forces), expected @ forces, atol=1e-7)


def test_more_points_extend_it(system):
    matrix, condensed = system
    more = sp.random_array((7, N), density=0.05, rng=np.random.default_rng(1), format="csr")
    whole = CondensedSystem.of(matrix, sp.csr_array(sp.vstack([condensed.points, more])), "grid", "dissection")
    np.testing.assert_allclose(condensed.with_points(more).compliance, whole.compliance, atol=1e-9)
    np.testing.assert_array_equal(condensed.with_points(more[:0]).compliance, condensed.compliance)


class Areas:
    """A system with fixed rows and rows of triangles, whose ratios none of them has without force."""

    def __init__(self):
        rng = np.random.default_rng(4)
        points = sp.random_array((30, N), density=0.05, rng=rng, format="csr")
        self.condensed = CondensedSystem.of(grid_laplacian(15), points, "grid", "cholespy")
        self.fixed, self.more, self.last, self.areas = (rows(rng, count, 30) for count in (5, 4, 3, 16))
        self.areas = SoftRows(self.areas.operator, np.repeat(self.areas.weights[::2], 2))  # one for each triangle
        self.soft = SoftSystem(self.condensed, self.fixed, self.areas)
        targets, ratios = rng.normal(size=(12, 3)), rng.uniform(0.5, 2.0, 8)
        self.problem = SoftProblem(rng.normal(size=(30, 3)), targets, ratios)

    def whole(self):
        return SoftSystem(self.condensed, SoftRows.stack([self.fixed, self.more, self.last], 30), self.areas)


def test_rows_added_later_are_rows_like_others():
    case = Areas()
    added = case.soft.with_fixed(case.more).with_fixed(case.last).solve(case.problem, 500, 1e-10)
    whole = case.whole().solve(case.problem, 500, 1e-10)
    assert whole.status is added.status is Status.CONVERGED
    assert len(whole.energy) > 5
    np.testing.assert_allclose(
        added.energy[:10], whole.energy[:10], rtol=1e-9
    )  # later, acceleration amplifies rounding
    assert added.energy[-1] == pytest.approx(whole.energy[-1], rel=1e-9)
    np.testing.assert_allclose(added.forces, whole.forces, atol=1e-7)
    before = SoftSystem(case.condensed, case.fixed, case.areas)
    np.testing.assert_array_equal(case.soft._inverse, before._inverse)  # the first system stays as it was
    np.testing.assert_array_equal(case.soft.fixed.weights, before.fixed.weights)


def test_a_start_close_by_saves_iterations():
    case = Areas()
    cold = case.whole().solve(case.problem, 500, 1e-8)
    warm = case.whole().solve(case.problem, 500, 1e-8, cold.goal)
    assert len(warm.energy) <= 2 < len(cold.energy)
    np.testing.assert_allclose(warm.forces, cold.forces, atol=1e-6)


class Scaled:
    """An acceleration that takes so much of each plain step: what is negative ascends."""

    def __init__(self, share):
        self.share = share

    def __call__(self, goal, residual):
        return residual if self.share == 1 else self.share * residual

    def restart(self):
        pass


def test_steps_that_ascend_are_replaced_by_plain_ones(monkeypatch):
    case, found = Areas(), []
    for share in (1.0, -1.0):
        monkeypatch.setattr("retarget.simulation.condensed.Anderson", lambda depth, share=share: Scaled(share))
        found.append(case.whole().solve(case.problem, 2000, 1e-6))
        assert found[-1].status is Status.CONVERGED
        assert (np.diff(found[-1].energy) < 0).all()
    assert len(found[0].energy) > 20
    np.testing.assert_array_equal(found[1].forces, found[0].forces)


def test_a_plain_step_that_raises_the_energy_fails(monkeypatch):
    case = Areas()
    monkeypatch.setattr("retarget.simulation.condensed.project", lambda g, ratios: 2 * g - project(g, ratios))
    assert case.whole().solve(case.problem, 2000, 1e-6).status is Status.FAILED


def test_the_solution_is_that_of_the_full_system(system):
    """Against a dense solution with the soft rows assembled into the matrix; energies too."""
    matrix, condensed = system
    rng = np.random.default_rng(2)
    fixed = rows(rng, 12, len(condensed.compliance))
    b, targets = rng.normal(size=(N, 3)), rng.normal(size=(12, 3))
    offset = rng.normal(size=(len(condensed.compliance), 3))
    free = condensed.free(b)
    problem = SoftProblem(condensed.points @ free + offset, targets, np.empty(0))
    none = SoftRows.stack([], len(condensed.compliance))
    solution = SoftSystem(condensed, fixed, none).solve(problem)

    onto = (fixed.operator @ condensed.points).toarray()
    full = matrix.toarray() + onto.T @ (fixed.weights[:, None] * onto)
    wanted = targets - fixed.operator @ offset
    exact = np.linalg.solve(full, b + onto.T @ (fixed.weights[:, None] * wanted))
    found = free + condensed.pulled(solution.forces)
    np.testing.assert_allclose(found, exact, atol=1e-9)

    def energy(x):
        soft = fixed.weights @ ((onto @ x - wanted) ** 2).sum(axis=1)
        return np.vdot(x, matrix @ x) - 2 * np.vdot(x, b) + soft

    elastic = np.vdot(free, matrix @ free) - 2 * np.vdot(free, b)
    assert solution.energy == pytest.approx((energy(exact) - elastic,))


def test_not_a_number_is_a_failure(system):
    _, condensed = system
    fixed = rows(np.random.default_rng(2), 3, len(condensed.compliance))
    none = SoftRows.stack([], len(condensed.compliance))
    problem = SoftProblem(np.full((len(condensed.compliance), 3), np.nan), np.zeros((3, 3)), np.empty(0))
    assert SoftSystem(condensed, fixed, none).solve(problem).status is Status.FAILED
