import numpy as np
import pytest
import scipy.sparse as sp

from retarget.simulation.condensed import CondensedSystem, SoftProblem, SoftRows, SoftSystem
from retarget.simulation.factor import factorise
from retarget.types import Status
from tests.retarget.geometry.test_cholesky import grid_laplacian

N = 225


def rows(rng, count, points, largest=10.0):
    return SoftRows(
        sp.random_array((count, points), density=0.3, rng=rng, format="csr"), rng.uniform(0.1, largest, count)
    )


def blocks(count):
    return np.split(np.random.default_rng(5).permutation(count), [count // 3, count // 2])


@pytest.fixture(params=[20, 300])
def system(request):
    """Fewer and more points than vertices that they hang on."""
    rng = np.random.default_rng(0)
    matrix = grid_laplacian(15)
    points = sp.random_array((request.param, N), density=0.02, rng=rng, format="csr")
    return matrix, CondensedSystem(factorise(matrix), points, blocks(request.param))


def test_the_compliance(system):
    matrix, condensed = system
    count = condensed.points.shape[0]
    expected = condensed.points @ np.linalg.solve(matrix.toarray(), condensed.points.T.toarray())
    assert condensed.known.sum() == count // 3
    for asked in (blocks(count)[2][:1], np.arange(count)):
        condensed.require(asked)
        assert condensed.known[asked].all()
        np.testing.assert_allclose(condensed.compliance[condensed.known], expected[condensed.known], atol=1e-9)
    forces = np.random.default_rng(3).normal(size=(count, 3))
    np.testing.assert_allclose(condensed.shifts(forces), expected @ forces, atol=1e-7)


def test_rows_are_the_same_in_whatever_order_they_were_asked_for(system):
    _, condensed = system
    count = condensed.points.shape[0]
    other = CondensedSystem(condensed.factor, condensed.points, blocks(count))
    for asked in range(count):
        condensed.require(np.array([asked]))
        other.require(np.array([count - 1 - asked]))
    np.testing.assert_array_equal(condensed.compliance, other.compliance)


def test_more_points_extend_it(system):
    _, condensed = system
    more = sp.random_array((7, N), density=0.05, rng=np.random.default_rng(1), format="csr")
    extended = condensed.with_points(more)
    count = condensed.points.shape[0]
    whole = CondensedSystem(condensed.factor, sp.csr_array(sp.vstack([condensed.points, more])), [np.arange(count + 7)])
    assert extended.known.sum() == condensed.known.sum() + 7
    extended.require(np.arange(count + 7))
    np.testing.assert_allclose(extended.compliance, whole.compliance, atol=1e-9)
    np.testing.assert_array_equal(condensed.known[:count].sum(), count // 3)


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
