import numpy as np
import pytest
import scipy.sparse as sp

from retarget.check import InvalidInput
from retarget.geometry.cholesky import NotPositiveDefinite
from retarget.simulation.factor import BACKENDS, factorise
from tests.retarget.geometry.test_cholesky import grid_laplacian


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_backend_solves_like_a_dense_solver(backend):
    matrix = grid_laplacian(15)
    rhs = np.random.default_rng(0).normal(size=(225, 3))
    factor = factorise(matrix, backend=backend)
    assert factor.size == 225
    np.testing.assert_allclose(factor.solve(rhs), np.linalg.solve(matrix.toarray(), rhs), atol=1e-12)
    np.testing.assert_array_equal(factor.solve(rhs[:, 0]).shape, (225,))
    assert factor.solve(rhs).flags.c_contiguous


@pytest.mark.parametrize("backend", BACKENDS)
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
        InvalidInput, match=r"backend: 'cholespi' is unknown.*cholespy, superlu.*Did you mean 'cholespy'"
    ):
        factorise(sp.eye_array(3), backend="cholespi")
