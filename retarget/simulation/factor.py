"""One interface for factors of symmetric positive definite systems, whichever library computes them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from retarget.geometry.cholesky import CholeskyFactor, NotPositiveDefinite
from retarget.simulation.dissection import DissectionFactor
from retarget.simulation.pardiso import PardisoFactor
from retarget.suggest import choose
from retarget.types import FloatArray


class Factor(Protocol):
    """The factor of a symmetric positive definite matrix (m, m)."""

    size: int

    def solve(self, rhs: FloatArray) -> FloatArray:
        """x with matrix @ x = rhs, for rhs of shape (m,) or (m, columns)."""
        ...


class SuperLUFactor:
    """scipy's LU factor with a symmetric ordering: the last resort, three times slower than cholespy."""

    def __init__(self, matrix: sp.sparray | sp.spmatrix, name: str = "matrix") -> None:
        csc = sp.csc_array(matrix)
        self.size = csc.shape[0]
        explanation = f"{name}: expected a symmetric positive definite matrix, got one that is singular or not finite."
        try:
            self._lu = splu(csc, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError as error:
            raise NotPositiveDefinite(explanation) from error
        known = np.cos(np.arange(self.size, dtype=np.float64))
        positive = (self._lu.U.diagonal() > 0).all()
        if not positive or not np.abs(self.solve(csc @ known) - known).max(initial=0.0) < 1e-3:  # also True for NaN
            raise NotPositiveDefinite(explanation)

    def solve(self, rhs: FloatArray) -> FloatArray:
        """x with matrix @ x = rhs, for rhs of shape (m,) or (m, columns)."""
        solution: FloatArray = self._lu.solve(np.asarray(rhs, dtype=np.float64))
        return np.ascontiguousarray(solution)


BACKENDS: dict[str, Callable[[sp.sparray | sp.spmatrix, str], Factor]] = {
    "cholespy": CholeskyFactor,  # fastest for the three columns of one frame
    "dissection": DissectionFactor,  # fastest for many columns: batches, condensation
    "pardiso": PardisoFactor,  # if the mkl wheel is installed
    "superlu": SuperLUFactor,
}


def factorise(matrix: sp.sparray | sp.spmatrix, name: str = "matrix", backend: str = "cholespy") -> Factor:
    """Factor of a symmetric positive definite matrix (m, m); `name` is what error messages call it.

    Raises NotPositiveDefinite where the system has no unique solution, InvalidInput for an unknown backend.
    """
    return BACKENDS[choose("backend", backend, BACKENDS)](matrix, name)
