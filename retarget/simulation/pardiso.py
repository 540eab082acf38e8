"""Intel's PARDISO (Schenk and Gaertner 2004) from the `mkl` wheel, through its C interface; an optional extra."""

from __future__ import annotations

import ctypes
import weakref
from functools import cache
from importlib import metadata
from typing import Any

import numpy as np
import scipy.sparse as sp

from retarget.check import InvalidInput
from retarget.geometry.cholesky import NotPositiveDefinite
from retarget.types import FloatArray

POSITIVE_DEFINITE = 2  # mtype: real, symmetric
FACTORISE, SOLVE, RELEASE = 12, 33, -1


class PardisoFactor:
    """The Cholesky factor of a symmetric positive definite matrix (m, m), in double precision.

    Raises InvalidInput if the wheel is not installed, NotPositiveDefinite for a matrix that is not.
    """

    def __init__(self, matrix: sp.sparray | sp.spmatrix, name: str = "matrix") -> None:
        self._library = _library()
        upper = sp.csr_array(sp.triu(matrix, format="csr"))
        upper.sort_indices()
        self.size = upper.shape[0]
        self._rows = [upper.data.astype(np.float64), upper.indptr.astype(np.int32), upper.indices.astype(np.int32)]
        self._handle, self._options = np.zeros(64, np.int64), np.zeros(64, np.int32)
        self._library.pardisoinit(_at(self._handle), ctypes.byref(ctypes.c_int(POSITIVE_DEFINITE)), _at(self._options))
        self._options[7] = 0  # no iterative refinement
        self._options[34] = 1  # indices count from zero
        error = self._call(FACTORISE, np.zeros((1, self.size)), np.zeros((1, self.size)))
        weakref.finalize(self, _release, self._library, self._handle, self._options, self.size)
        known = np.cos(np.arange(self.size, dtype=np.float64))
        if error or not np.abs(self.solve(sp.csr_array(matrix) @ known) - known).max(initial=0.0) < 1e-3:
            raise NotPositiveDefinite(
                f"{name}: expected a symmetric positive definite matrix, got one that is singular or not finite."
            )

    def solve(self, rhs: FloatArray) -> FloatArray:
        """x with matrix @ x = rhs, for rhs of shape (m,) or (m, columns)."""
        columns = np.ascontiguousarray(np.asarray(rhs, dtype=np.float64).reshape(self.size, -1).T)
        solution = np.zeros_like(columns)
        if error := self._call(SOLVE, columns, solution):
            raise ArithmeticError(f"PARDISO: error {error} in a solve.")
        return np.ascontiguousarray(solution.T).reshape(np.shape(rhs))

    def _call(self, phase: int, columns: FloatArray, solution: FloatArray) -> int:
        return _pardiso(
            self._library,
            self._handle,
            self._options,
            self.size,
            phase,
            [_at(a) for a in self._rows],
            columns,
            solution,
        )


def _pardiso(
    library: ctypes.CDLL,
    handle: Any,
    options: Any,
    size: int,
    phase: int,
    matrix: list[ctypes.c_void_p],
    columns: FloatArray,
    solution: FloatArray,
) -> int:
    one, error = ctypes.byref(ctypes.c_int(1)), ctypes.c_int(0)
    kind, step, order, count, quiet = (
        ctypes.byref(ctypes.c_int(n)) for n in (POSITIVE_DEFINITE, phase, size, len(columns), 0)
    )
    right, left, errors = _at(columns), _at(solution), ctypes.byref(error)
    library.pardiso(
        _at(handle), one, one, kind, step, order, *matrix, None, count, _at(options), quiet, right, left, errors
    )
    return error.value


def _release(library: ctypes.CDLL, handle: Any, options: Any, size: int) -> None:
    nothing = np.zeros((1, 1))
    _pardiso(library, handle, options, size, RELEASE, [ctypes.c_void_p(None)] * 3, nothing, nothing)


def _at(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@cache
def _library() -> ctypes.CDLL:
    try:
        found = [f for f in metadata.files("mkl") or [] if f.name.startswith(("libmkl_rt.", "mkl_rt."))]
        return ctypes.CDLL(str(found[0].locate()))
    except (metadata.PackageNotFoundError, IndexError, OSError) as error:
        raise InvalidInput(
            "backend = pardiso: expected the `mkl` wheel, got none that loads; pip install mkl, or use cholespy."
        ) from error
