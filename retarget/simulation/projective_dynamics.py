"""Quasi-static projective dynamics with Anderson acceleration (Bouaziz et al. 2014; Peng et al. 2018).

Minimised, lengths in mm and volumes V_t in cm^3, as a number without dimension:

    E(x) =  sum_t strain_t min_{R in SO(3)} ||F_t - R||^2
          + sum_t volume_t min_{det D = 1}  ||F_t - D||^2
          + sum_k target_k ||(P x - s)_k||^2 / (10 mm)^2                            eqs (11) to (14)

over the free vertices; the fixed ones (skull) are Dirichlet data. One factor serves all iterations and all targets.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from retarget.check import InvalidInput, check_vertices
from retarget.simulation.factor import factorise
from retarget.simulation.local_step import LocalStep, TetrahedralEnergy
from retarget.simulation.tetrahedra import RestShape, gradient_operator
from retarget.types import FloatArray, IntArray, SolveInfo, Status

LENGTH_UNIT = 10.0  # mm: Table 3 names no unit, Fig. 5 is in cm


@dataclass(frozen=True)
class TissueWeights:
    """Weight of strain and volume preservation of each tet (t,), volume in cm^3 included."""

    strain: FloatArray
    volume: FloatArray


def tissue_weights(
    shape: RestShape, muscle: ArrayLike, w_soft: float = 1.0, w_muscle: float = 1.0, muscle_strain: float = 0.05
) -> TissueWeights:
    """w_S and w_M of eq. (14), Table 3, times volume, for muscle (t,) bool.

    `muscle_strain` is the share of w_M that muscle tets spend on strain. # differs from the paper: volume preservation
    alone (eq. (12)) leaves them free to wander and to invert, so the minimum is not unique.
    """
    is_muscle = np.asarray(muscle, dtype=bool)
    if is_muscle.shape != shape.volumes.shape:
        raise InvalidInput(f"muscle: expected one flag for each of the {len(shape.tets)} tets, got {is_muscle.shape}.")
    if not (w_soft > 0 and w_muscle > 0 and muscle_strain > 0):
        raise InvalidInput(
            f"tissue weights: expected w_soft, w_muscle and muscle_strain above 0, got {w_soft}, {w_muscle} and "
            f"{muscle_strain}; without strain the muscle has no unique shape."
        )
    return TissueWeights(
        strain=shape.volumes * np.where(is_muscle, w_muscle * muscle_strain, w_soft),
        volume=shape.volumes * np.where(is_muscle, w_muscle, w_soft),
    )


@dataclass(frozen=True)
class SolverSettings:
    """Iteration stops where the relative energy change and the rms step are both below their tolerance."""

    max_iterations: int = 100
    energy_tolerance: float = 1e-4
    step_tolerance: float = 0.01  # mm, rms over the free vertices
    anderson_depth: int = 5  # 0 is plain projective dynamics
    repair_inverted_start: bool = False  # accept a start with inverted tets; the projections pull them back
    backend: str = "cholespy"

    def __post_init__(self) -> None:
        if not (self.max_iterations >= 1 and self.anderson_depth >= 0):
            raise InvalidInput("SolverSettings: expected max_iterations >= 1 and anderson_depth >= 0.")
        if not (self.energy_tolerance > 0 and self.step_tolerance > 0):
            raise InvalidInput("SolverSettings: expected energy_tolerance > 0 and step_tolerance > 0.")


@dataclass(frozen=True)
class Equilibrium:
    """Where a solve ended. A FAILED solve returns the rest shape, never NaN."""

    vertices: FloatArray  # (n, 3) mm
    info: SolveInfo  # energy at the start and after each iteration
    rms_steps: tuple[float, ...]  # mm, one per iteration
    inverted: int  # tets with det F <= 0 at the result


class ProjectiveDynamics:
    """The inverse problem of eq. (14), factorised once for a rest shape, fixed vertices and a target operator."""

    def __init__(
        self,
        shape: RestShape,
        weights: TissueWeights,
        fixed: ArrayLike = (),
        target_operator: sp.sparray | sp.spmatrix | None = None,
        target_weights: float | FloatArray = 100.0,
        settings: SolverSettings | None = None,
    ) -> None:
        """fixed: (c,) vertex indices; target_operator: P (k, n), rows summing to one; target_weights: w_tar of
        eq. (14), one number or (k,) >= 0, which also makes soft constraints for artistic control.

        Raises InvalidInput, or NotPositiveDefinite where the minimum is not unique (nothing holds a component).
        """
        n = len(shape.vertices)
        self.shape = shape
        self.settings = settings or SolverSettings()
        self.fixed: IntArray = np.unique(np.asarray(fixed, dtype=np.int64))
        if len(self.fixed) and (self.fixed[0] < 0 or self.fixed[-1] >= n):
            raise InvalidInput(f"fixed: expected vertex indices from 0 to {n - 1}, got {self.fixed[[0, -1]].tolist()}.")
        self.free: IntArray = np.setdiff1d(np.arange(n), self.fixed)
        if len(self.free) == 0:
            raise InvalidInput("fixed: expected at least one free vertex, got none.")
        self._embed = sp.csr_array((0, n)) if target_operator is None else sp.csr_array(target_operator)
        if self._embed.shape[1] != n:
            raise InvalidInput(f"target_operator: expected {n} columns, one per vertex, got {self._embed.shape}.")
        self._pull = (
            np.broadcast_to(np.asarray(target_weights, dtype=np.float64), self._embed.shape[:1]) / LENGTH_UNIT**2
        )
        if not (np.isfinite(self._pull).all() and (self._pull >= 0).all()):
            raise InvalidInput("target_weights: expected finite numbers >= 0.")
        for name, w in (("strain", weights.strain), ("volume", weights.volume)):
            if w.shape != shape.volumes.shape or not np.isfinite(w).all() or (w < 0).any():
                raise InvalidInput(
                    f"weights.{name}: expected finite numbers >= 0, one for each of {len(shape.tets)} tets."
                )
        self._tissue = TetrahedralEnergy(shape, weights.strain, weights.volume)
        gradient = gradient_operator(shape)
        per_row = np.repeat(weights.strain + weights.volume, 3)
        matrix = gradient.T @ sp.diags_array(per_row) @ gradient
        matrix = matrix + self._embed.T @ sp.diags_array(self._pull) @ self._embed
        matrix = sp.csr_array(matrix)[self.free][:, self.free]
        self._factor = factorise(matrix, "projective dynamics", self.settings.backend)

    def energy_and_descent(self, vertices: FloatArray, targets: FloatArray | None = None) -> tuple[float, FloatArray]:
        """E and minus half its gradient (n, 3) at vertices (n, 3), for targets s (k, 3) mm."""
        energy, descent, _ = self._evaluate(vertices, self._targets(targets))
        return energy, descent

    def _targets(self, targets: FloatArray | None) -> FloatArray:
        count = self._embed.shape[0]
        return check_vertices("targets", np.empty((0, 3)) if targets is None else targets, count)

    def _evaluate(self, x: FloatArray, targets: FloatArray) -> tuple[float, FloatArray, LocalStep]:
        local = self._tissue(x)
        miss = targets - self._embed @ x
        energy = local.energy + float(np.einsum("k,kc,kc", self._pull, miss, miss))  # eq. (14)
        return energy, local.descent + self._embed.T @ (self._pull[:, None] * miss), local  # eq. (13)

    def solve(
        self,
        targets: FloatArray | None = None,
        fixed_positions: FloatArray | None = None,
        start: FloatArray | None = None,
    ) -> Equilibrium:
        """Minimise from start (n, 3) mm, the rest shape by default; targets (k, 3) mm, fixed_positions (c, 3) mm.

        The fixed vertices are in ascending order of their index, at rest by default. A start with NaN or, unless
        `repair_inverted_start`, inverted tets (after the fixed vertices moved) ends with FAILED.
        Raises InvalidInput for targets and fixed positions that are not finite or of another count.
        """
        goal = self._targets(targets)
        x = np.array(self.shape.vertices if start is None else start, dtype=np.float64)
        if x.shape != self.shape.vertices.shape:
            raise InvalidInput(f"start: expected {self.shape.vertices.shape}, got {x.shape}.")
        if fixed_positions is not None:
            x[self.fixed] = check_vertices("fixed_positions", fixed_positions, len(self.fixed))
        elif start is not None:
            x[self.fixed] = self.shape.vertices[self.fixed]
        if not np.isfinite(x).all():
            return self._failed("start: not finite")
        energy, descent, local = self._evaluate(x, goal)
        if local.inverted and not self.settings.repair_inverted_start:
            return self._failed(f"start: {local.inverted} tets are inverted or flat", (energy,))
        return self._iterate(x, goal, energy, descent, local)

    def _iterate(
        self, x: FloatArray, goal: FloatArray, energy: float, descent: FloatArray, local: LocalStep
    ) -> Equilibrium:
        settings, free = self.settings, self.free
        energies, steps = [energy], []
        accelerate = Anderson(settings.anderson_depth)
        for _ in range(settings.max_iterations):
            residual = self._factor.solve(descent[free])  # global step: x + residual is the plain iterate
            move = accelerate(x[free], residual)
            moved = x.copy()
            moved[free] += move
            candidate = self._evaluate(moved, goal)
            if not candidate[0] <= energy and move is not residual:  # safeguard: the plain iterate never ascends
                accelerate.restart()
                move = residual
                moved[free] = x[free] + move
                candidate = self._evaluate(moved, goal)
            if not np.isfinite(candidate[0]):
                return self._failed("the energy is not finite", tuple(energies))
            step = float(np.sqrt((move**2).sum(axis=1).mean()))
            # At rounding level even the plain iterate may ascend: stay.
            ascended = candidate[0] > energy
            if not ascended:
                change = energy - candidate[0]
                x, (energy, descent, local) = moved, candidate
                energies.append(energy)
                steps.append(step)
            if ascended or (
                (change <= settings.energy_tolerance * energy or energy <= self._negligible)
                and (step <= settings.step_tolerance)
            ):
                return self._ended(Status.CONVERGED, x, energies, steps, local)
        return self._ended(Status.MAX_ITERATIONS, x, energies, steps, local)

    @property
    def _negligible(self) -> float:
        return 1e-14 * float(self.shape.volumes.sum())

    def _ended(
        self, status: Status, x: FloatArray, energies: list[float], steps: list[float], local: LocalStep
    ) -> Equilibrium:
        message = f"{local.inverted} inverted tets" if local.inverted else ""
        return Equilibrium(x, SolveInfo(status, len(steps), tuple(energies), message), tuple(steps), local.inverted)

    def _failed(self, message: str, energies: tuple[float, ...] = ()) -> Equilibrium:
        finite = tuple(e for e in energies if np.isfinite(e))
        return Equilibrium(
            self.shape.vertices.copy(), SolveInfo(Status.FAILED, max(len(finite) - 1, 0), finite, message), (), 0
        )


class Anderson:
    """Anderson acceleration, type II (Walker and Ni 2011): the step that a fixed-point iteration should take next."""

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.restart()

    def restart(self) -> None:
        """Forget the history; the next step is plain."""
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._states: deque[FloatArray] = deque(maxlen=max(self.depth, 1))
        self._residuals: deque[FloatArray] = deque(maxlen=max(self.depth, 1))
        self._products: FloatArray = np.empty((0, 0))

    def __call__(self, state: FloatArray, residual: FloatArray) -> FloatArray:
        """The step from `state`, where the plain one is `residual`; returns `residual` itself without a history."""
        if self.depth == 0:
            return residual
        if self._last is not None:
            self._states.append(state - self._last[0])
            self._residuals.append(residual - self._last[1])
            self._extend_products()
        self._last = state, residual
        if not self._residuals:
            return residual
        right = np.array([_dot(r, residual) for r in self._residuals])
        ridge = 1e-12 * np.trace(self._products) * np.eye(len(right))
        try:
            weights = np.linalg.solve(self._products + ridge, right)
        except np.linalg.LinAlgError:
            return residual
        step = residual.copy()
        for weight, change, change_of_residual in zip(weights, self._states, self._residuals, strict=True):
            step -= weight * (change + change_of_residual)
        return step

    def _extend_products(self) -> None:
        """Inner products of the residual changes: drop the oldest, add the newest."""
        kept = self._products[-(len(self._residuals) - 1) :, -(len(self._residuals) - 1) :]
        m = len(self._residuals)
        products = np.empty((m, m))
        if m > 1:
            products[:-1, :-1] = kept
        products[-1] = products[:, -1] = [_dot(self._residuals[-1], r) for r in self._residuals]
        self._products = products


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Inner product without BLAS, whose waiting threads would hold up those of the local step."""
    return float(np.einsum("vc,vc", a, b))
