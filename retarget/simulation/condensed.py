"""Quadratic energies with soft terms on few points, condensed to these points.

Wanted is the minimum over x (n, 3) of

    x^T A x - 2 x^T b  +  sum_i w_i |s_i (C x + c) - t_i|^2

where A is factorised once, C picks m points and the rows s_i act on them alone. With the compliance K = C A^-1 C^T,
made once as well, the free state x0 = A^-1 b and its points q0 = C x0 + c, the minimum has multipliers

    mu = (S K S^T + W^-1)^-1 (t - S q0),    x = x0 + A^-1 C^T S^T mu,    E = E(x0) + mu^T (S K S^T + W^-1) mu.

So targets, areas and contacts change a dense system of the size of the soft rows, and a solution costs two
back-substitutions with A whatever happens in between.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numba import njit
from scipy.linalg import solve_triangular

from retarget.simulation.area_terms import project
from retarget.simulation.dissection import DissectionFactor
from retarget.simulation.factor import Factor, factorise
from retarget.simulation.projective_dynamics import Anderson
from retarget.types import FloatArray, IntArray, Status

ROUNDING = 1e-6  # of the energy


class CondensedSystem:
    """The factor of A (n, n) and the compliance K (m, m) of points C (m, n)."""

    def __init__(self, factor: Factor, points: sp.csr_array, compliance: FloatArray) -> None:
        self.factor, self.points, self.compliance = factor, points, compliance

    @classmethod
    def of(cls, matrix: sp.csr_array, points: sp.csr_array, name: str, backend: str) -> CondensedSystem:
        """Raises NotPositiveDefinite for a matrix that is not."""
        factor = factorise(matrix, name, backend)
        if not points.shape[0]:
            return cls(factor, points, np.empty((0, 0)))
        dissected = factor if isinstance(factor, DissectionFactor) else DissectionFactor(matrix, name)
        return cls(factor, points, dissected.compliance(points))

    def with_points(self, more: sp.csr_array) -> CondensedSystem:
        """The system with further points (h, n) under the present ones; only their columns are computed."""
        points, m = sp.csr_array(sp.vstack([self.points, more])), self.points.shape[0]
        if not more.shape[0]:
            return self
        across = points @ self.factor.solve(more.toarray().T)
        return CondensedSystem(self.factor, points, np.block([[self.compliance, across[:m]], [across.T]]))

    def free(self, rhs: FloatArray) -> FloatArray:
        """x0 (n, 3) for b (n, 3): the minimum without soft terms."""
        return self.factor.solve(rhs)

    def shifts(self, forces: FloatArray) -> FloatArray:
        """K f (m, 3): what forces f (m, 3) move the points by."""
        return moves(self.compliance, forces)

    def pulled(self, forces: FloatArray) -> FloatArray:
        """A^-1 C^T f (n, 3): what forces f (m, 3) at the points move the vertices by."""
        return self.factor.solve(self.points.T @ forces)


def moves(compliance: FloatArray, forces: FloatArray) -> FloatArray:
    """K f (m, 3) for forces f (m, 3) on a few points: only their rows of the symmetric K (m, m) are read."""
    moved = np.zeros((len(compliance), 3))
    _move(compliance, forces, np.flatnonzero(forces.any(axis=1)), moved)
    return moved


@njit(cache=True)
def _move(compliance, forces, pulled, moved):  # type: ignore[no-untyped-def]
    for k in pulled:
        a, b, c = forces[k, 0], forces[k, 1], forces[k, 2]
        for i in range(len(moved)):
            moved[i, 0] += compliance[k, i] * a
            moved[i, 1] += compliance[k, i] * b
            moved[i, 2] += compliance[k, i] * c


@dataclass(frozen=True)
class SoftRows:
    """Rows S (r, m) on the points with weights (r,) > 0."""

    operator: sp.csr_array
    weights: FloatArray

    @classmethod
    def stack(cls, parts: Sequence[SoftRows], points: int) -> SoftRows:
        """All rows, one part under the other, on `points` points; parts on fewer points act on the first ones."""
        padded = [_widen(part.operator, points) for part in parts]
        operator = sp.csr_array(sp.vstack([sp.csr_array((0, points)), *padded]))
        return cls(operator, np.concatenate([np.empty(0), *(part.weights for part in parts)]))


def _widen(operator: sp.csr_array, points: int) -> sp.csr_array:
    return sp.csr_array((operator.data, operator.indices, operator.indptr), shape=(operator.shape[0], points))


@dataclass(frozen=True)
class SoftProblem:
    """What changes from one expression to the next."""

    points: FloatArray  # q0 (m, 3) mm, where the points are without soft terms
    targets: FloatArray  # (r, 3) of the fixed rows
    ratios: FloatArray  # (k,) wanted area ratios


@dataclass(frozen=True)
class CondensedSolution:
    """The minimum; `energy` is what it has beyond E(x0), at the start and after each iteration."""

    forces: FloatArray  # (m, 3) at the points: all rows together
    held: FloatArray  # (r, 3) multipliers of the fixed rows, the forces that each exerts
    goal: FloatArray  # (2 k, 3) gradients that the triangles were drawn to
    energy: tuple[float, ...]
    status: Status


class SoftSystem:
    """The dense system of one set of soft rows: `fixed` with given targets, `areas` (2 k) with wanted area ratios and
    the same weight for both rows of a triangle, as their projection minimises the unweighted distance.

    In multipliers (held, pull) it reads [[inner, across], [across^T, outer]], with the lower factor L of `inner`,
    half = L^-1 across and the inverse P^-1 + R^T R of what is left of `outer` once `fixed` is eliminated.
    """

    def __init__(self, system: CondensedSystem, fixed: SoftRows, areas: SoftRows) -> None:
        self.system, self.fixed, self.areas = system, fixed, areas
        from_fixed = fixed.operator @ system.compliance
        self._across = from_fixed @ areas.operator.T
        self._lower = _lower(_regular(from_fixed @ fixed.operator.T, fixed.weights))
        self._back = _inverted(self._lower)  # applied twice for each solution, where a substitution wakes threads
        self._half = _substitute(self._lower, self._across)
        outer = _regular(areas.operator @ system.compliance @ areas.operator.T, areas.weights)
        self._inverse = np.linalg.inv(outer - self._half.T @ self._half)  # small, and applied in every iteration
        self._rise = np.empty((0, len(outer)))  # R

    def with_fixed(self, more: SoftRows) -> SoftSystem:
        """The system with more fixed rows under the present ones, at the cost of their number alone."""
        new = copy.copy(self)
        new.fixed = SoftRows.stack([self.fixed, more], self.fixed.operator.shape[1])
        from_more = more.operator @ self.system.compliance
        left = _substitute(self._lower, (from_more @ self.fixed.operator.T).T)
        below = _lower(_regular(from_more @ more.operator.T, more.weights) - left.T @ left)
        across = from_more @ self.areas.operator.T
        half = _substitute(below, across - left.T @ self._half)
        lifted = self._inverse @ half.T + self._rise.T @ (self._rise @ half.T)
        risen = _substitute(_lower(_regular(-half @ lifted, np.ones(len(half)))), lifted.T)  # Woodbury
        new._across, new._half = np.vstack([self._across, across]), np.vstack([self._half, half])
        new._lower = np.block([[self._lower, np.zeros((len(self._lower), len(below)))], [left.T, below]])
        new._back = _inverted(new._lower)
        new._rise = np.vstack([self._rise, risen])
        return new

    def compliance(self, points: IntArray) -> FloatArray:
        """(p, p): what forces at `points` (p,) of the system's points move them by while the soft rows hold.

        The areas' gradients are drawn to where they are drawn to now; that changes little far away from them.
        """
        free = self.system.compliance
        left = _substitute(self._lower, (self.fixed.operator @ free)[:, points])
        pulled = (self.areas.operator @ free)[:, points] - self._half.T @ left
        risen = self._rise @ pulled
        held: FloatArray = (
            free[np.ix_(points, points)] - left.T @ left - pulled.T @ self._inverse @ pulled - risen.T @ risen
        )
        return held

    def solve(
        self,
        problem: SoftProblem,
        max_iterations: int = 200,
        tolerance: float = 1e-5,
        start: FloatArray | None = None,
    ) -> CondensedSolution:
        """start: `goal` of a solution close by.

        Without areas the minimum is exact at once. With them, projective dynamics on the rows of the triangles,
        accelerated and safeguarded: the energy never rises. It stops where a plain iteration would change the
        triangles' projected gradients by less than `tolerance` (rms). A plain iteration that raises the energy by more
        than rounding ends with FAILED.
        """
        points, ratios = problem.points, problem.ratios
        miss = problem.targets - self.fixed.operator @ points
        held = self._hold(miss)
        base = float(np.vdot(miss, held))
        if not len(ratios):
            forces = self.fixed.operator.T @ held
            return CondensedSolution(forces, held, np.empty((0, 3)), (base,), _status(base, Status.CONVERGED))
        drift = self.areas.operator @ points + self._across.T @ held  # the triangles if their terms were absent
        goal = project(drift, ratios) if start is None else start
        energy, pull, projected = self._evaluate(drift, goal, ratios)
        energies, status = [base + energy], Status.MAX_ITERATIONS
        accelerate = Anderson(5)
        for _ in range(max_iterations):
            residual = projected - goal
            if np.sqrt((residual**2).mean()) < tolerance:
                status = Status.CONVERGED
                break
            step = accelerate(goal, residual)
            candidate = self._evaluate(drift, goal + step, ratios)
            if not candidate[0] <= energy and step is not residual:  # safeguard: the plain iterate never ascends
                accelerate.restart()
                step = residual
                candidate = self._evaluate(drift, goal + step, ratios)
            if not candidate[0] <= energy:
                rounding = candidate[0] - energy <= ROUNDING * (base + energy)
                status = Status.CONVERGED if rounding else Status.FAILED
                break
            goal = goal + step
            energy, pull, projected = candidate
            energies.append(base + energy)
        held = self._hold(miss - self._across @ pull)
        forces = self.fixed.operator.T @ held + self.areas.operator.T @ pull
        return CondensedSolution(forces, held, goal, tuple(energies), _status(energies[-1], status))

    def _hold(self, miss: FloatArray) -> FloatArray:
        """Multipliers of the fixed rows that miss their targets by (r, 3)."""
        held: FloatArray = self._back.T @ (self._back @ miss)
        return held

    def _evaluate(
        self, drift: FloatArray, goal: FloatArray, ratios: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Energy of the areas at the minimum for the goal (2 k, 3), the multipliers, and the next goal."""
        pull = self._inverse @ (goal - drift) + self._rise.T @ (self._rise @ (goal - drift))
        gradients = goal - pull / self.areas.weights[:, None]
        projected = project(gradients, ratios)
        elastic = float(np.vdot(pull, goal - drift)) - float(np.vdot(pull, pull / self.areas.weights[:, None]))
        missed = float(np.vdot(self.areas.weights, ((gradients - projected) ** 2).sum(axis=1)))
        return elastic + missed, pull, projected


def _regular(matrix: FloatArray, weights: FloatArray) -> FloatArray:
    """matrix + W^-1, in place."""
    matrix[np.diag_indices_from(matrix)] += 1 / weights
    return matrix


def _lower(matrix: FloatArray) -> FloatArray:
    """L with L L^T = matrix."""
    return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)


def _substitute(lower: FloatArray, rhs: FloatArray) -> FloatArray:
    """L^-1 rhs; neither need have rows."""
    if not rhs.size:
        return rhs
    solution: FloatArray = solve_triangular(lower, rhs, lower=True, check_finite=False)
    return solution


def _inverted(lower: FloatArray) -> FloatArray:
    """L^-1."""
    return _substitute(lower, np.eye(len(lower)))


def _status(energy: float, status: Status) -> Status:
    return status if np.isfinite(energy) else Status.FAILED
