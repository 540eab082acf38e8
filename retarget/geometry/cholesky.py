"""Sparse Cholesky factors for systems that are solved many times."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from cholespy import CholeskySolverD, MatrixType

from retarget.types import FloatArray


class NotPositiveDefinite(ArithmeticError):
    """A system whose solution is not unique; the message says what usually causes it."""


class CholeskyFactor:
    """The factor of a symmetric positive definite matrix (m, m), in double precision.

    The same matrix and right-hand side give the same bits, whatever the number of threads; the columns of a
    right-hand side do not influence each other beyond rounding. cholespy reads one triangle and accepts NaN and
    matrices that are singular up to rounding, so construction solves once for a known vector and raises
    NotPositiveDefinite if that does not come back.
    """

    def __init__(self, matrix: sp.sparray | sp.spmatrix, name: str = "matrix") -> None:
        csc = sp.csc_array(matrix)
        csc.sort_indices()
        self.size = csc.shape[0]
        try:
            self._solver = CholeskySolverD(
                self.size, csc.indptr.astype(np.int32), csc.indices.astype(np.int32), csc.data, MatrixType.CSC
            )
        except ValueError as error:
            raise NotPositiveDefinite(_explanation(name)) from error
        known = np.cos(np.arange(self.size, dtype=np.float64))
        if not np.abs(self.solve(csc @ known) - known).max(initial=0.0) < 1e-3:  # also True for NaN
            raise NotPositiveDefinite(_explanation(name))

    def solve(self, rhs: FloatArray) -> FloatArray:
        """x with matrix @ x = rhs, for rhs of shape (m,) or (m, columns)."""
        columns = np.ascontiguousarray(rhs, dtype=np.float64)
        solution = np.empty_like(columns)
        self._solver.solve(columns, solution)
        return solution


def _explanation(name: str) -> str:
    return (
        f"{name}: expected a symmetric positive definite matrix, got one that is singular, indefinite or not finite. "
        "Degenerate triangles, a component without a pinned vertex and zero weights are the usual causes."
    )
