"""A sparse Cholesky factor by nested dissection whose triangular solves run on all threads.

METIS orders (Karypis and Kumar 1998) and SuperLU factorises, once. The solves, which every iteration repeats, are
written for it here: several columns at a time, in single precision where only a correction is wanted, and with
independent subtrees of the elimination tree side by side (Heath, Ng and Peyton 1991).
"""

from __future__ import annotations

import heapq

import numpy as np
import pymetis
import scipy.sparse as sp
from numba import njit, prange
from scipy.sparse.linalg import splu

from retarget.geometry.cholesky import NotPositiveDefinite
from retarget.types import FloatArray, IntArray

GROUPS = 8  # of subtrees; fixed, so that sums have one order whatever the number of threads
SPLIT = 4  # subtrees per group at least, to balance their work
BLOCK = 96  # columns at a time of a compliance
FUSE = {"contract"}  # no reordering of sums: gathered vectors are slower than scalars here


class DissectionFactor:
    """A = L D L^T, permuted, of a symmetric positive definite matrix (m, m); `single` is the precision of solves.

    The same matrix and right-hand side give the same bits, whatever the number of threads. Raises NotPositiveDefinite
    for a matrix that is not.
    """

    def __init__(self, matrix: sp.sparray | sp.spmatrix, name: str = "matrix", single: bool = False) -> None:
        csr = sp.csr_array(matrix)
        self.size = csr.shape[0]
        explanation = (
            f"{name}: expected a symmetric positive definite matrix, got one that is singular, indefinite or not "
            "finite. Degenerate elements, a component that nothing holds and zero weights are the usual causes."
        )
        if not np.isfinite(csr.data).all():
            raise NotPositiveDefinite(explanation)
        order = _nested_dissection(csr)
        try:
            lu = splu(
                sp.csc_array(csr[order][:, order]),
                permc_spec="NATURAL",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise NotPositiveDefinite(explanation) from error
        pivots = lu.U.diagonal()
        if not (pivots > 0).all() or not (lu.perm_r == np.arange(self.size)).all():
            raise NotPositiveDefinite(explanation)
        again, self._bounds = _grouped(sp.csc_array(lu.L))
        lower = sp.csc_array(sp.csc_array(lu.L)[again][:, again])
        lower.sort_indices()  # the unit diagonal comes first in each column, rows of the top last
        self._order = order[again]
        real = np.float32 if single else np.float64
        self._starts, self._rows = lower.indptr.astype(np.int64), lower.indices.astype(np.uint32)
        self._values, self._pivots = lower.data.astype(real), pivots[again].astype(real)
        above_top = np.repeat(np.arange(self.size), np.diff(self._starts))[lower.indices < self._bounds[-1]]
        self._splits = self._starts[:-1] + np.bincount(above_top, minlength=self.size)
        known = np.cos(np.arange(self.size, dtype=np.float64))
        if not np.abs(self.solve(csr @ known) - known).max(initial=0.0) < 1e-3:  # also True for NaN
            raise NotPositiveDefinite(explanation)

    def solve(self, rhs: FloatArray) -> FloatArray:
        """x with matrix @ x = rhs, for rhs of shape (m,) or (m, columns)."""
        columns = np.asarray(rhs, dtype=np.float64).reshape(self.size, -1)
        x = columns[self._order].astype(self._values.dtype)
        top = np.zeros((GROUPS, self.size - self._bounds[-1], x.shape[1]), x.dtype)
        _solve(self._starts, self._splits, self._rows, self._values, self._pivots, self._bounds, top, x)
        solution = np.empty(columns.shape)
        solution[self._order] = x
        return solution.reshape(np.shape(rhs))

    def compliance(self, rows: sp.csr_array) -> FloatArray:
        """rows A^-1 rows^T (r, r) for sparse rows (r, m).

        Solved for the unknowns in `rows` and their ancestors in the elimination tree alone: no other column of the
        factor changes what comes back. For the lips of a head these are a third of the factor, and the time a sixth.
        """
        place = np.empty(self.size, dtype=np.int64)
        place[self._order] = np.arange(self.size)
        reached = np.zeros(self.size, dtype=bool)
        reached[place[rows.indices]] = True
        for column in range(self.size):  # the first row below the diagonal is the parent
            if reached[column] and self._starts[column + 1] > self._starts[column] + 1:
                reached[self._rows[self._starts[column] + 1]] = True
        kept = np.flatnonzero(reached)
        factor = (self._values, self._rows.astype(np.int64), self._starts)
        lower = sp.csc_array(sp.csc_array(factor, shape=(self.size, self.size))[:, kept][kept])
        lower.sort_indices()
        starts, below = lower.indptr.astype(np.int64), lower.indices.astype(np.uint32)
        inside = (np.cumsum(reached) - 1)[place[rows.indices]]
        picked = sp.csr_array((rows.data, inside, rows.indptr), shape=(rows.shape[0], len(kept)))
        result = np.empty((rows.shape[0], rows.shape[0]))
        for first in range(0, rows.shape[0], BLOCK):
            x = np.ascontiguousarray(picked[first : first + BLOCK].toarray().T, dtype=self._values.dtype)
            none = np.zeros((0, len(kept), x.shape[1]), x.dtype)
            _solve(starts, starts[:-1], below, lower.data, self._pivots[kept], np.zeros(1, np.int64), none, x)
            result[:, first : first + BLOCK] = picked @ x
        return result


def _nested_dissection(matrix: sp.csr_array) -> IntArray:
    """(m,) the vertex at each place of METIS's ordering of the matrix's graph."""
    graph = sp.csr_array(matrix - sp.diags_array(matrix.diagonal()))
    graph.eliminate_zeros()
    graph.sort_indices()
    adjacency = pymetis.CSRAdjacency(adj_starts=graph.indptr, adjacent=graph.indices)
    return np.asarray(pymetis.nested_dissection(adjacency)[0], dtype=np.int64)


def _grouped(lower: sp.csc_array) -> tuple[IntArray, IntArray]:
    """An equivalent ordering: GROUPS runs of columns that do not touch each other, then the top of the tree.

    The new order of the columns and the bounds (GROUPS + 1,) of the runs.
    """
    lower.sort_indices()
    size, counts = lower.shape[0], np.diff(lower.indptr)
    parents = np.full(size, size)
    parents[counts > 1] = lower.indices[lower.indptr[:-1][counts > 1] + 1]  # the elimination tree, size is its root
    work = np.append(counts, 0)
    for column, parent in enumerate(parents):
        work[parent] += work[column]
    by_parent = np.argsort(parents, kind="stable")
    ends = np.searchsorted(parents[by_parent], np.arange(size + 2))

    def children(column: int) -> IntArray:
        return by_parent[ends[column] : ends[column + 1]]

    roots = [(-int(work[c]), int(c)) for c in children(size)]  # split the heaviest until the work can be shared out
    heapq.heapify(roots)
    while roots and (len(roots) < SPLIT * GROUPS or -roots[0][0] * GROUPS > work[size]) and len(children(roots[0][1])):
        for child in children(heapq.heappop(roots)[1]):
            heapq.heappush(roots, (-int(work[child]), int(child)))
    group = np.full(size + 1, GROUPS)  # GROUPS marks the top
    load = [0] * GROUPS
    for negative, root in sorted(roots):
        group[root] = lightest = int(np.argmin(load))
        load[lightest] -= negative
    for column in range(size - 1, -1, -1):  # children come before their parents
        if group[column] == GROUPS:
            group[column] = group[parents[column]]
    order = np.argsort(group[:size], kind="stable")
    return order, np.searchsorted(group[:size][order], np.arange(GROUPS + 1)).astype(np.int64)


@njit(cache=True, parallel=True)
def _solve(starts, splits, rows, values, pivots, bounds, top, x):  # type: ignore[no-untyped-def]
    first = bounds[-1]
    for group in prange(len(bounds) - 1):
        for j in range(bounds[group], bounds[group + 1]):
            _subtract(rows, values, starts[j] + 1, splits[j], x, j, 0, x)
            _subtract(rows, values, splits[j], starts[j + 1], x, j, first, top[group])
    for group in range(len(top)):
        x[first:] += top[group]
    for j in range(first, len(x)):
        _subtract(rows, values, starts[j] + 1, starts[j + 1], x, j, 0, x)
    for j in range(len(x) - 1, first - 1, -1):
        _substitute(rows, values, starts[j] + 1, starts[j + 1], pivots, x, j)
    for group in prange(len(bounds) - 1):
        for j in range(bounds[group + 1] - 1, bounds[group] - 1, -1):
            _substitute(rows, values, starts[j] + 1, starts[j + 1], pivots, x, j)


@njit(cache=True, fastmath=FUSE)
def _subtract(rows, values, begin, end, x, j, offset, target):  # type: ignore[no-untyped-def]
    """target[rows - offset] -= values x_j."""
    if x.shape[1] == 3:
        a, b, c = x[j, 0], x[j, 1], x[j, 2]
        for p in range(begin, end):
            i, v = rows[p] - offset, values[p]
            target[i, 0] -= v * a
            target[i, 1] -= v * b
            target[i, 2] -= v * c
    else:
        for p in range(begin, end):
            i, v = rows[p] - offset, values[p]
            for k in range(x.shape[1]):
                target[i, k] -= v * x[j, k]


@njit(cache=True, fastmath=FUSE)
def _substitute(rows, values, begin, end, pivots, x, j):  # type: ignore[no-untyped-def]
    """x_j <- x_j / pivot - sum values x[rows]."""
    if x.shape[1] == 3:
        a, b, c = x[j, 0] / pivots[j], x[j, 1] / pivots[j], x[j, 2] / pivots[j]
        d, e, f = x.dtype.type(0), x.dtype.type(0), x.dtype.type(0)  # a second sum, not to wait for the first
        half = begin + (end - begin) // 2
        for p in range(half - begin):
            i, v = rows[begin + p], values[begin + p]
            a -= v * x[i, 0]
            b -= v * x[i, 1]
            c -= v * x[i, 2]
            i, v = rows[half + p], values[half + p]
            d -= v * x[i, 0]
            e -= v * x[i, 1]
            f -= v * x[i, 2]
        if (end - begin) % 2:
            i, v = rows[end - 1], values[end - 1]
            a -= v * x[i, 0]
            b -= v * x[i, 1]
            c -= v * x[i, 2]
        x[j, 0], x[j, 1], x[j, 2] = a + d, b + e, c + f
    else:
        for k in range(x.shape[1]):
            x[j, k] /= pivots[j]
        for p in range(begin, end):
            i, v = rows[p], values[p]
            for k in range(x.shape[1]):
                x[j, k] -= v * x[i, k]
