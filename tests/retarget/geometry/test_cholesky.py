import os
import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sp

from retarget.geometry.cholesky import CholeskyFactor, NotPositiveDefinite


def grid_laplacian(side):
    line = sp.diags_array([-np.ones(side - 1), np.full(side, 2.0), -np.ones(side - 1)], offsets=[-1, 0, 1])
    return sp.kron(sp.eye_array(side), line) + sp.kron(line, sp.eye_array(side))


def test_solves_like_a_dense_solver():
    matrix = grid_laplacian(12)
    rhs = np.random.default_rng(0).normal(size=(144, 5))
    expected = np.linalg.solve(matrix.toarray(), rhs)
    factor = CholeskyFactor(matrix)
    np.testing.assert_allclose(factor.solve(rhs), expected, atol=1e-12)
    np.testing.assert_allclose(factor.solve(rhs[:, 0]), expected[:, 0], atol=1e-12)
    np.testing.assert_allclose(factor.solve(np.asfortranarray(rhs)), expected, atol=1e-12)


@pytest.mark.parametrize(
    "matrix",
    [
        sp.csc_array([[1.0, 2.0], [2.0, 1.0]]),  # indefinite
        sp.csc_array([[1.0, -1.0], [-1.0, 1.0]]),  # singular
        sp.csc_array([[2.0, 1.0], [0.0, 2.0]]),  # not symmetric
        sp.csc_array([[1.0, 0.0], [0.0, np.nan]]),
        sp.csgraph.laplacian(sp.kron(sp.eye_array(3), np.ones((40, 40))) / 3.0),  # singular up to rounding
    ],
    ids=["indefinite", "singular", "asymmetric", "nan", "singular up to rounding"],
)
def test_refuses_what_has_no_unique_solution(matrix):
    with pytest.raises(NotPositiveDefinite, match="my system: expected a symmetric positive definite"):
        CholeskyFactor(matrix, "my system")


PROGRAM = """
import hashlib, numpy as np
from tests.retarget.geometry.test_cholesky import CholeskyFactor, grid_laplacian
rhs = np.random.default_rng(0).normal(size=(3600, 24))
factor = CholeskyFactor(grid_laplacian(60))
assert np.array_equal(factor.solve(rhs), factor.solve(rhs))
print(hashlib.sha256(factor.solve(rhs).tobytes()).hexdigest())
"""


def test_same_bits_for_any_number_of_threads():
    def bits(threads):
        environment = os.environ | {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        return subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
        ).stdout

    assert bits("1") == bits("2") == bits("1")
