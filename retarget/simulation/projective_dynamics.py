"""Quasi-static projective dynamics with Anderson acceleration (Bouaziz et al. 2014; Peng et al. 2018).

Minimised, lengths in mm and volumes V_t in cm^3, as a number without dimension:

    E(x) =  sum_t strain_t min_{R in SO(3)} ||F_t - R||^2
          + sum_t volume_t min_{det D = 1}  ||F_t - D||^2
          + sum_k target_k ||(P x - s)_k||^2 / (10 mm)^2                            eqs (11) to (14)
          - sum_v f_v . (x - X)_v                                                   external forces, in 1/mm

over the free vertices; the fixed ones (skull) are Dirichlet data. One factor serves all iterations and all targets.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

from retarget.check import InvalidInput, check_points
from retarget.geometry.cholesky import NotPositiveDefinite
from retarget.simulation.anderson import Anderson
from retarget.simulation.factor import factorise
from retarget.simulation.local_step import TetrahedralEnergy
from retarget.simulation.tetrahedra import RestShape, count_inverted, gradient_operator
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
        strain=shape.volumes * np.where(is_muscle, w_muscle * muscle_strain, w_soft),  # eq. (11), first term
        volume=shape.volumes * np.where(is_muscle, w_muscle, w_soft),  # eq. (11), second term, and eq. (12)
    )


@dataclass(frozen=True)
class SolverSettings:
    """Iteration stops where the relative energy change and the rms step are both below their tolerance.

    A plain step r from the descent d = -grad E / 2 lowers the energy by d . r at least, as the projections' quadratic
    form bounds it from above, and to first order by 2 d . r. With `bounded_end` a step for which the latter is small
    enough ends the solve as it is: the last energy reported is then the upper bound E - d . r.
    """

    max_iterations: int = 100
    energy_tolerance: float = 1e-4
    step_tolerance: float = 0.01  # mm, rms over the free vertices
    anderson_depth: int = 5  # 0 is plain projective dynamics
    repair_inverted_start: bool = False  # accept a start with inverted tets; the projections pull them back
    single_precision: bool = True  # of the projections; energies reach a relative accuracy of 1e-7
    bounded_end: bool = False  # a last step whose effect is known to be small enough is taken without its projections
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


@dataclass(frozen=True)
class Problem:
    """What one solve is given; None stands for nothing, or for what there is at rest."""

    targets: FloatArray | None = None  # s (k, 3) mm
    fixed_positions: FloatArray | None = None  # (c, 3) mm, of the fixed vertices in ascending order of their index
    start: FloatArray | None = None  # (n, 3) mm, used as it is but for the fixed vertices
    near: tuple[FloatArray, FloatArray] | None = None  # vertices (n, 3) and targets (k, 3) mm of a solved neighbour
    forces: FloatArray | None = None  # (n, 3) in 1/mm


@dataclass(frozen=True)
class _Evaluation:
    energy: float
    stored: float  # the part that is never negative: all but the forces' potential
    descent: FloatArray  # (f, 3), of the free vertices
    inverted: int


_Iteration = Generator[FloatArray, FloatArray, Equilibrium]  # yields right-hand sides, takes solutions


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
        embed = sp.csr_array((0, n)) if target_operator is None else sp.csr_array(target_operator)
        if embed.shape[1] != n:
            raise InvalidInput(f"target_operator: expected {n} columns, one per vertex, got {embed.shape}.")
        self._pull = np.broadcast_to(np.asarray(target_weights, dtype=np.float64), embed.shape[:1]) / LENGTH_UNIT**2
        if not (np.isfinite(self._pull).all() and (self._pull >= 0).all()):
            raise InvalidInput("target_weights: expected finite numbers >= 0.")
        for name, w in (("strain", weights.strain), ("volume", weights.volume)):
            if w.shape != shape.volumes.shape or not np.isfinite(w).all() or (w < 0).any():
                raise InvalidInput(
                    f"weights.{name}: expected finite numbers >= 0, one for each of {len(shape.tets)} tets."
                )
        gradient = gradient_operator(shape)
        per_row = np.repeat(weights.strain + weights.volume, 3)
        matrix = gradient.T @ sp.diags_array(per_row) @ gradient
        matrix = sp.csr_array(matrix + embed.T @ sp.diags_array(self._pull) @ embed)

        # Inside, free vertices come first, neighbours close together; their coordinates are one block of memory.
        banded = reverse_cuthill_mckee(sp.csr_matrix(matrix[self.free][:, self.free]), symmetric_mode=True)
        self._order = np.concatenate([self.free[banded], self.fixed])
        self._place = np.argsort(self._order)
        count = len(self.free)
        self._rest = shape.vertices[self._order]
        self._tissue = TetrahedralEnergy(
            replace(shape, tets=self._place[shape.tets], vertices=self._rest),
            weights.strain,
            weights.volume,
            self.settings.single_precision,
        )
        self._embed = sp.csr_array(embed[:, self._order])
        self._gather = sp.csr_array(self._embed[:, :count].T)
        matrix = sp.csr_array(matrix[self._order[:count]][:, self._order])
        self._from_fixed = matrix[:, count:]
        self._check_held(matrix[:, :count])
        self._factor = factorise(matrix[:, :count], "projective dynamics", self.settings.backend)

    def _check_held(self, matrix: sp.csr_array) -> None:
        """A factorisation alone finds loose pieces only where rounding lets it."""
        pieces, piece = connected_components(matrix, directed=False)
        held = (abs(self._from_fixed).sum(axis=1) > 0) | (self._gather @ self._pull > 0)
        loose = np.setdiff1d(np.arange(pieces), piece[held])
        if len(loose):
            raise NotPositiveDefinite(
                f"projective dynamics: {len(loose)} of {pieces} connected pieces are held by nothing; expected a fixed "
                "vertex or a target on each. Drop loose tets, fix some of their vertices or give them a target."
            )

    def seen(self, vertices: FloatArray) -> FloatArray:
        """P x (k, 3) mm: where the points that have targets are, for vertices (n, 3) mm."""
        points: FloatArray = self._embed @ vertices[self._order]
        return points

    def energy_and_descent(
        self, vertices: FloatArray, targets: FloatArray | None = None, forces: FloatArray | None = None
    ) -> tuple[float, FloatArray]:
        """E and minus half its gradient (n, 3), 0 at fixed vertices, at vertices (n, 3) for targets s (k, 3) mm."""
        found = self._evaluate(vertices[self._order], self._targets(targets), self._forces(forces))
        descent = np.zeros_like(self._rest)
        descent[: len(self.free)] = found.descent
        return found.energy, descent[self._place]

    def solve(
        self,
        targets: FloatArray | None = None,
        fixed_positions: FloatArray | None = None,
        start: FloatArray | None = None,
        near: tuple[FloatArray, FloatArray] | None = None,
        forces: FloatArray | None = None,
    ) -> Equilibrium:
        """Minimise, from `start` (n, 3) mm where given: targets (k, 3) mm, fixed_positions (c, 3) mm, forces (n, 3).

        Otherwise from a solved neighbour `near`, vertices and targets, by default the rest shape, to which the
        harmonic extension of the *change* in targets and fixed vertices is added: one solve, no projection.
        The fixed vertices are in ascending order of their index, at rest by default. A start with NaN or, unless
        `repair_inverted_start`, inverted tets (after the fixed vertices moved) ends with FAILED; an extension
        may invert tets and goes on.
        Raises InvalidInput for targets and fixed positions that are not finite or of another count.
        """
        return self.solve_many([Problem(targets, fixed_positions, start, near, forces)])[0]

    def solve_many(self, problems: Sequence[Problem]) -> list[Equilibrium]:
        """As `solve`, each problem by itself, but with one back-substitution for all of them in each round."""
        running = {number: self._minimise(problem) for number, problem in enumerate(problems)}
        ended: dict[int, Equilibrium] = {}
        right = self._advance(running, dict.fromkeys(running), ended)
        while right:
            columns = self._factor.solve(np.hstack(list(right.values())))
            solved = dict(zip(right, np.split(columns, len(right), axis=1), strict=True))
            right = self._advance(running, solved, ended)
        return [ended[number] for number in range(len(problems))]

    @staticmethod
    def _advance(
        running: dict[int, _Iteration], solved: dict[int, FloatArray] | dict[int, None], ended: dict[int, Equilibrium]
    ) -> dict[int, FloatArray]:
        """Hand each iteration its solution; the right-hand sides of those that go on."""
        right = {}
        for number, solution in solved.items():
            try:
                right[number] = running[number].send(solution)  # type: ignore[arg-type]
            except StopIteration as stop:
                ended[number] = stop.value
        return right

    def _minimise(self, problem: Problem) -> _Iteration:
        goal, forces = self._targets(problem.targets), self._forces(problem.forces)
        count = len(self.free)
        wanted = self._rest[count:]
        if problem.fixed_positions is not None:
            wanted = check_points("fixed_positions", problem.fixed_positions, len(self.fixed), "fixed vertex")
        if problem.start is not None:
            x = self._inside("start", problem.start)
            x[count:] = wanted
        else:
            near, goal_there = problem.near or (self.shape.vertices, None)
            x = self._inside("near", near)
            change = goal - (self._embed @ x if goal_there is None else self._targets(goal_there))
            right = self._gather @ (self._pull[:, None] * change) - self._from_fixed @ (wanted - x[count:])
            x[count:] = wanted
            if right.any():
                x[:count] += yield right
        if not np.isfinite(x).all():
            return self._failed("start: not finite")
        current = self._evaluate(x, goal, forces)
        if current.inverted and problem.start is not None and not self.settings.repair_inverted_start:
            return self._failed(f"start: {current.inverted} tets are inverted or flat", (current.energy,))
        return (yield from self._iterate(x, current, goal, forces))

    def _inside(self, name: str, vertices: FloatArray) -> FloatArray:
        v = np.asarray(vertices, dtype=np.float64)
        if v.shape != self.shape.vertices.shape:
            raise InvalidInput(f"{name}: expected {self.shape.vertices.shape}, got {v.shape}.")
        return v[self._order]

    def _targets(self, targets: FloatArray | None) -> FloatArray:
        count = self._embed.shape[0]
        return check_points("targets", np.empty((0, 3)) if targets is None else targets, count, "row of the operator")

    def _forces(self, forces: FloatArray | None) -> FloatArray | None:
        if forces is None:
            return None
        return check_points("forces", forces, len(self._order), "vertex")[self._order[: len(self.free)]]

    def _evaluate(self, x: FloatArray, goal: FloatArray, forces: FloatArray | None) -> _Evaluation:
        local, count = self._tissue(x), len(self.free)
        miss = goal - self._embed @ x
        pull = self._pull[:, None] * miss
        stored = local.energy + float(np.einsum("kc,kc", pull, miss))  # eqs (13), (14)
        descent = local.descent[:count] + self._gather @ pull
        energy = stored
        if forces is not None:
            energy -= float(np.einsum("vc,vc", forces, x[:count] - self._rest[:count]))
            descent += 0.5 * forces
        return _Evaluation(energy, stored, descent, local.inverted)

    def _iterate(self, x: FloatArray, current: _Evaluation, goal: FloatArray, forces: FloatArray | None) -> _Iteration:
        settings, count = self.settings, len(self.free)
        energies, steps = [current.energy], []
        accelerate = Anderson(settings.anderson_depth)
        for _ in range(settings.max_iterations):
            residual = yield current.descent  # global step: x + residual is the plain iterate
            if settings.bounded_end:
                gain = float(np.einsum("vc,vc", current.descent, residual))
                step = float(np.sqrt(np.einsum("vc,vc", residual, residual) / count))
                if 0 <= 2 * gain <= settings.energy_tolerance * current.stored and step <= settings.step_tolerance:
                    x[:count] += residual
                    energies.append(current.energy - gain)
                    steps.append(step)
                    inverted = count_inverted(x[self._place], self.shape.tets)
                    return self._ended(Status.CONVERGED, x, energies, steps, inverted)
            move = accelerate(x[:count], residual)
            moved = x.copy()
            moved[:count] += move
            candidate = self._evaluate(moved, goal, forces)
            if not candidate.energy <= current.energy and move is not residual:
                accelerate.restart()  # safeguard: the plain iterate never ascends
                move = residual
                moved[:count] = x[:count] + move
                candidate = self._evaluate(moved, goal, forces)
            if not np.isfinite(candidate.energy):
                return self._failed("the energy is not finite", tuple(energies))
            step = float(np.sqrt(np.einsum("vc,vc", move, move) / count))
            # At rounding level even the plain iterate may ascend: stay.
            rise = candidate.energy - current.energy
            ascended = rise > 0
            if rise > self._rounding * current.stored + self._negligible:
                return self._failed(f"a plain step raised the energy by {rise:.3g}", tuple(energies))
            if not ascended:
                change = current.energy - candidate.energy
                x, current = moved, candidate
                energies.append(current.energy)
                steps.append(step)
            if ascended or (
                (change <= settings.energy_tolerance * current.stored or current.stored <= self._negligible)
                and (step <= settings.step_tolerance)
            ):
                return self._ended(Status.CONVERGED, x, energies, steps, current.inverted)
        return self._ended(Status.MAX_ITERATIONS, x, energies, steps, current.inverted)

    @property
    def _rounding(self) -> float:
        """Of energies, relative; an order above what is measured."""
        return 1e-6 if self.settings.single_precision else 1e-12

    @property
    def _negligible(self) -> float:
        return (1e-11 if self.settings.single_precision else 1e-14) * float(self.shape.volumes.sum())

    def _ended(
        self, status: Status, x: FloatArray, energies: list[float], steps: list[float], inverted: int
    ) -> Equilibrium:
        message = f"{inverted} inverted tets" if inverted else ""
        info = SolveInfo(status, len(steps), tuple(energies), message)
        return Equilibrium(x[self._place], info, tuple(steps), inverted)

    def _failed(self, message: str, energies: tuple[float, ...] = ()) -> Equilibrium:
        finite = tuple(e for e in energies if np.isfinite(e))
        return Equilibrium(
            self.shape.vertices.copy(), SolveInfo(Status.FAILED, max(len(finite) - 1, 0), finite, message), (), 0
        )
