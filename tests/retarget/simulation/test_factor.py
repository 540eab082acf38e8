import numpy as np
import pytest
import scipy.sparse as sp

from retarget.check import InvalidInput
from retarget.geometry.cholesky import NotPositiveDefinite
from retarget.simulation import pardiso
from retarget.simulation.dissection import DissectionFactor
from retarget.simulation.factor import BACKENDS, factorise
from tests.retarget.geometry.test_cholesky import grid_laplacian
from tests.retarget.simulation.threads import with_one_and_two_threads


def installed(backend):
    try:
        factorise(sp.eye_array(3), backend=backend)
    except InvalidInput:
        return False
    return True


INSTALLED = [
    pytest.param(b, marks=pytest.mark.skipif(not installed(b), reason=f"{b}: its wheel is not installed"))
    for b in BACKENDS
]


@pytest.mark.parametrize("backend", INSTALLED)
def test_every_backend_solves_like_a_dense_solver(backend):
    matrix = grid_laplacian(15)
    rhs = np.random.default_rng(0).normal(size=(225, 3))
    factor = factorise(matrix, backend=backend)
    assert factor.size == 225
    np.testing.assert_allclose(factor.solve(rhs), np.linalg.solve(matrix.toarray(), rhs), atol=1e-12)
    np.testing.assert_array_equal(factor.solve(rhs[:, 0]).shape, (225,))
    assert factor.solve(rhs).flags.c_contiguous


@pytest.mark.parametrize("backend", INSTALLED)
@pytest.mark.parametrize(
    "matrix",
    [
        sp.csc_array([[1.0, 2.0], [2.0, 1.0]]),  # indefinite
        sp.csc_array([[1.0, -1.0], [-1.0, 1.0]]),  # singular
        sp.csc_array([[1.0, 0.0], [0.0, np.nan]]),
    ],
    ids=["indefinite", "singular", "nan"],
)
def test_every_backend_refuses_what_has_no_unique_solution(backend, matrix):
    with pytest.raises(NotPositiveDefinite, match="my system: expected a symmetric positive definite"):
        factorise(matrix, "my system", backend)


def test_an_unknown_backend_is_refused():
    with pytest.raises(
        InvalidInput,
        match=r"backend: 'cholespi' is unknown.*cholespy, dissection, pardiso, superlu.*Did you mean 'cholespy'",
    ):
        factorise(sp.eye_array(3), backend="cholespi")


def test_many_columns_are_solved_like_single_ones():
    matrix = grid_laplacian(40)
    rhs = np.random.default_rng(0).normal(size=(1600, 12))
    factor, single = DissectionFactor(matrix), DissectionFactor(matrix, single=True)
    expected = factorise(matrix).solve(rhs)
    together = factor.solve(rhs)
    np.testing.assert_allclose(together, expected, atol=1e-10)
    np.testing.assert_allclose(np.hstack([factor.solve(c) for c in np.split(rhs, 4, axis=1)]), together, atol=1e-10)
    np.testing.assert_allclose(single.solve(rhs), expected, atol=1e-4 * np.abs(expected).max())


def test_the_factor_gives_the_same_bits_for_any_number_of_threads():
    rhs = np.random.default_rng(0).normal(size=(1600, 12))
    factor = DissectionFactor(grid_laplacian(40))
    np.testing.assert_array_equal(*with_one_and_two_threads(lambda: factor.solve(rhs)))


def test_a_missing_wheel_is_named(monkeypatch):
    monkeypatch.setattr(pardiso.metadata, "files", lambda name: [])
    pardiso._library.cache_clear()
    with pytest.raises(InvalidInput, match="expected the `mkl` wheel"):
        factorise(sp.eye_array(3), backend="pardiso")
    pardiso._library.cache_clear()
