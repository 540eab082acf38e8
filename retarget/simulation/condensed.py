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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from retarget.simulation.area_terms import project
from retarget.simulation.factor import Factor
from retarget.simulation.projective_dynamics import Anderson
from retarget.types import FloatArray, IntArray, Status

BLOCK = 48  # right-hand sides per solve while the compliance is made


class CondensedSystem:
    """The factor of A (n, n) and the compliance K (m, m) of points C (m, n).

    Rows of K are made when they are first needed, in `blocks` that do not depend on what was needed before, so the
    same question has the same answer to the bit. compliance[i] is valid where known[i].
    """

    def __init__(self, factor: Factor, points: sp.csr_array, blocks: Sequence[IntArray]) -> None:
        """blocks: sets of points that together hold every point once; the first is made at once."""
        self.factor, self.points = factor, points
        m = points.shape[0]
        self.compliance = np.empty((m, m))
        self.known = np.zeros(m, dtype=bool)
        self._blocks = list(blocks)
        self._block_of = np.empty(m, dtype=np.int64)
        for number, block in enumerate(blocks):
            self._block_of[block] = number
        self.require(blocks[0])

    def require(self, points: IntArray) -> None:
        """Make the rows of K of these points, where they are missing."""
        for number in np.unique(self._block_of[points[~self.known[points]]]):
            block = self._blocks[number]
            self.compliance[block] = _responses(self.factor, self.points, self.points[block]).T
            self.known[block] = True

    def with_points(self, more: sp.csr_array) -> CondensedSystem:
        """The system with further points (h, n) under the present ones; only their columns are computed."""
        m, h = self.points.shape[0], more.shape[0]
        new = CondensedSystem.__new__(CondensedSystem)
        new.factor, new.points = self.factor, sp.csr_array(sp.vstack([self.points, more]))
        across = _responses(self.factor, new.points, more)
        new.compliance = np.block([[self.compliance, across[:m]], [across.T]])
        new.known = np.concatenate([self.known, np.ones(h, dtype=bool)])
        new._blocks = [*self._blocks, np.arange(m, m + h)]
        new._block_of = np.concatenate([self._block_of, np.full(h, len(self._blocks))])
        return new

    def free(self, rhs: FloatArray) -> FloatArray:
        """x0 (n, 3) for b (n, 3): the minimum without soft terms."""
        return self.factor.solve(rhs)

    def shifts(self, forces: FloatArray) -> FloatArray:
        """K f (m, 3): what forces f (m, 3), on points with a known row, move the points by."""
        pulled = np.flatnonzero(forces.any(axis=1))
        moved: FloatArray = self.compliance[pulled].T @ forces[pulled]
        return moved

    def pulled(self, forces: FloatArray) -> FloatArray:
        """A^-1 C^T f (n, 3): what forces f (m, 3) at the points move the vertices by."""
        return self.factor.solve(self.points.T @ forces)


def _responses(factor: Factor, rows: sp.csr_array, columns: sp.csr_array) -> FloatArray:
    """rows A^-1 columns^T (r, c)."""
    result = np.empty((rows.shape[0], columns.shape[0]))
    for start in range(0, columns.shape[0], BLOCK):
        block = slice(start, start + BLOCK)
        result[:, block] = rows @ factor.solve(columns[block].toarray().T)
    return result


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
    energy: tuple[float, ...]
    status: Status


class SoftSystem:
    """The dense system of one set of soft rows: `fixed` with given targets, `areas` (2 k) with wanted area ratios."""

    def __init__(self, system: CondensedSystem, fixed: SoftRows, areas: SoftRows) -> None:
        self.fixed, self.areas = fixed, areas
        system.require(np.union1d(fixed.operator.indices, areas.operator.indices))
        from_fixed, from_areas = fixed.operator @ system.compliance, areas.operator @ system.compliance
        across = from_fixed @ areas.operator.T
        inner = from_fixed @ fixed.operator.T
        inner[np.diag_indices_from(inner)] += 1 / fixed.weights
        outer = from_areas @ areas.operator.T
        outer[np.diag_indices_from(outer)] += 1 / areas.weights
        self._across = across
        self._factor = cho_factor(inner, lower=True, check_finite=False) if len(inner) else None
        if self._factor is not None and len(outer):
            half = solve_triangular(self._factor[0], across, lower=True, check_finite=False)
            outer = outer - half.T @ half
        self._inverse = np.linalg.inv(outer) if len(outer) else outer  # small, and applied in every iteration

    def solve(self, problem: SoftProblem, max_iterations: int = 200, tolerance: float = 1e-5) -> CondensedSolution:
        """Without areas the minimum is exact at once. With them, projective dynamics on the rows of the triangles,
        accelerated and safeguarded: the energy never rises. It stops where a plain iteration would change the
        triangles' projected gradients by less than `tolerance` (rms).
        """
        points, ratios = problem.points, problem.ratios
        miss = problem.targets - self.fixed.operator @ points
        held = self._hold(miss)
        base = float(np.vdot(miss, held))
        if not len(ratios):
            return CondensedSolution(self.fixed.operator.T @ held, held, (base,), _status(base, Status.CONVERGED))
        drift = self.areas.operator @ points + self._across.T @ held  # the triangles if their terms were absent
        goal = project(drift, ratios)
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
            if not candidate[0] <= energy:  # rounding
                status = Status.CONVERGED
                break
            goal = goal + step
            energy, pull, projected = candidate
            energies.append(base + energy)
        held = self._hold(miss - self._across @ pull)
        forces = self.fixed.operator.T @ held + self.areas.operator.T @ pull
        return CondensedSolution(forces, held, tuple(energies), _status(energies[-1], status))

    def _hold(self, miss: FloatArray) -> FloatArray:
        """Multipliers of the fixed rows that miss their targets by (r, 3)."""
        if self._factor is None:
            return miss
        held: FloatArray = cho_solve(self._factor, miss, check_finite=False)
        return held

    def _evaluate(
        self, drift: FloatArray, goal: FloatArray, ratios: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Energy of the areas at the minimum for the goal (2 k, 3), the multipliers, and the next goal."""
        pull = self._inverse @ (goal - drift)
        gradients = goal - pull / self.areas.weights[:, None]
        projected = project(gradients, ratios)
        elastic = float(np.vdot(pull, goal - drift)) - float(np.vdot(pull, pull / self.areas.weights[:, None]))
        missed = float(np.vdot(self.areas.weights, ((gradients - projected) ** 2).sum(axis=1)))
        return elastic + missed, pull, projected


def _status(energy: float, status: Status) -> Status:
    return status if np.isfinite(energy) else Status.FAILED
