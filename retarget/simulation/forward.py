"""The forward simulation fwdSim of eq. (10): deformation gradients, bones and characteristics applied to a head.

Minimised, lengths in mm and volumes V_t in cm^3, as a number without dimension, over the vertices that no bone holds:

    E(x) =  sum_t w_t V_t ||F_t - DG_t||^2                                     eqs (18), (A.5), (A.6)
          + w_lc sum_k ||(P x + r)_k - F_lc,k||^2 / (10 mm)^2                   eq. (A.4)
          + sum_f w_f A_f min { ||F_f - D||^2 : area of D as wanted }           eqs (A.2), (A.3), see `area_terms`
          + sum_h w_h ||handle_h - target_h||^2 / (10 mm)^2  -  sum_v V_v g . x_v   artistic control

Everything but the tissue acts on a few hundred points of the skin, so the system is condensed to them.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from threadpoolctl import ThreadpoolController

from retarget.anatomy.head import Head
from retarget.check import InvalidInput, check_points
from retarget.simulation.bones import at_rest, carry_bones, check_moves, place_bones
from retarget.simulation.characteristics import Characteristics
from retarget.simulation.collisions import SHALLOW, Lips
from retarget.simulation.condensed import CondensedSolution, CondensedSystem, SoftProblem, SoftRows, SoftSystem
from retarget.simulation.contact_forces import Apart, Parting
from retarget.simulation.gradient_energy import GradientEnergy
from retarget.simulation.materials import check_gravity, check_stiffness
from retarget.simulation.soft_terms import NONE, Goals, Handles, SoftTerms, SoftWeights, handle_points
from retarget.simulation.state import Bones, HeadState
from retarget.simulation.tetrahedra import rest_shape, vertex_volumes
from retarget.types import FloatArray, IntArray, SolveInfo, Status

ACCEPTED = 0.1  # mm: deeper lips are not resolved
WORTH = 0.25  # of the depth that may be left where lips are parted in part


@cache
def _libraries() -> ThreadpoolController:
    """Those with threads of their own; to find them takes longer than to set them."""
    return ThreadpoolController()


@dataclass(frozen=True)
class ForwardSettings:
    """Weights of eqs (18) and (A.1), and tolerances."""

    w_soft: float = 1.0  # w_nabla-S of Table 3
    w_muscle: float = 1.0  # w_nabla-M of Table 3
    w_lip_contour: float = 1000.0  # differs from the paper: w_F = 10 of Table 3 meets the contour half-way at best
    w_eye_opening: float = 1000.0  # as well; see `weights` for the unit, and `area_terms` for that of areas
    w_eye_socket: float = 1000.0
    area_tolerance: float = 1e-5  # rms change of the triangles' gradients in one iteration
    area_iterations: int = 200
    collisions: bool = True  # step 3
    collision_stiffness: float = 1000.0  # of a contact, relative to that of the lips at one point
    collision_rounds: int = 12
    least_way: float = 0.0  # of the lips' way from rest that may be given up for parting them: 0 all, 1 none of it
    backend: str = "cholespy"

    def __post_init__(self) -> None:
        weights = self.w_soft, self.w_muscle, self.w_lip_contour, self.w_eye_opening, self.w_eye_socket
        if not (min(weights[:2]) > 0 and min(weights) >= 0 and np.isfinite(weights).all()):
            raise InvalidInput(f"ForwardSettings: expected w_soft, w_muscle > 0 and all weights >= 0, got {weights}.")
        if not (self.collision_stiffness > 0 and self.collision_rounds >= 1):
            raise InvalidInput("ForwardSettings: expected collision_stiffness > 0 and collision_rounds >= 1.")
        if not 0 <= self.least_way <= 1:
            raise InvalidInput(f"ForwardSettings: expected a least_way from 0 to 1, got {self.least_way}.")
        if not (self.area_iterations >= 1 and self.area_tolerance > 0):
            raise InvalidInput("ForwardSettings: expected area_iterations >= 1 and area_tolerance > 0.")


@dataclass(frozen=True)
class LipReport:
    """What became of lip collisions."""

    before: float = 0.0  # mm, how deep they are in each other after the first run
    after: float = 0.0  # mm, how deep the lips still are in each other, by the winding number; see `Lips.depth`
    contacts: int = 0  # points of the skin that push
    rounds: int = 0  # times that contacts were found and solved for
    way: float = 1.0  # of the way from rest that the lips have gone: less where they could not be parted further on

    @classmethod
    def of(cls, before: float, after: float, parted: Apart) -> LipReport:
        return cls(before, after, int(parted.touching.sum()), parted.rounds, parted.way)


@dataclass(frozen=True)
class ForwardState(HeadState):
    """The result of a forward simulation; `info.energy` is that of the last run, at its start and per iteration."""

    lips: LipReport = LipReport()


@dataclass(frozen=True)
class _Run:
    """A minimum, and what its forces move the points by, (m, 3) mm."""

    solution: CondensedSolution
    shifts: FloatArray


@dataclass(frozen=True)
class _Formed:
    """The head of a run: tet vertices (v, 3) mm and skin (n, 3) mm."""

    run: _Run
    vertices: FloatArray
    skin: FloatArray


class ForwardSimulation:
    """fwdSim of eq. (10) for one head, with everything made that does not depend on the expression."""

    def __init__(self, head: Head, settings: ForwardSettings | None = None, stiffness: ArrayLike = 1.0) -> None:
        """stiffness: factors (t,) > 0 of the tets' weights, or one number; see `materials.region_stiffness`.

        Raises InvalidInput for regions that do not fit, NotPositiveDefinite if no bone holds the head.
        """
        self.head, self.settings = head, settings or ForwardSettings()
        template, rules = head.template, self.settings
        self.shape = rest_shape(head.vertices, template.tets)
        factors = check_stiffness(stiffness, len(self.shape.tets))
        weights = self.shape.volumes * np.where(template.muscle, rules.w_muscle, rules.w_soft) * factors  # eq. (18)
        self._tissue = GradientEnergy(self.shape, weights)  # eqs (A.5), (A.6)
        self._mass = vertex_volumes(self.shape)[:, None]
        self._fixed = template.fixed
        self._free = np.setdiff1d(np.arange(len(head.vertices)), self._fixed)
        self._lips = Lips(head.skin, template.faces, template.regions) if rules.collisions else None
        parts = SoftWeights(rules.w_lip_contour, rules.w_eye_opening, rules.w_eye_socket)
        self._terms = SoftTerms(head, parts, self._lips.vertices if self._lips else NONE)
        self._points = self._terms.points
        self._offset = self._offset_of_tissue = self._terms.offset
        self._handles, self._held = SoftRows.stack([], self._points.shape[0]), NONE
        self._detail: FloatArray | float = 0.0

        matrix = self._tissue.matrix()
        self._from_fixed = matrix[self._free][:, self._fixed]
        self._system = self._without_handles = CondensedSystem.of(
            matrix[self._free][:, self._free], self._points[:, self._free], "forward simulation", rules.backend
        )
        self._soft: dict[tuple[str, ...], SoftSystem] = {}
        self._partings: dict[SoftSystem, Parting] = {}

    def with_handles(self, handles: Handles) -> ForwardSimulation:
        """The same simulation with these handles in place of any others. Nothing is factorised again.

        Raises InvalidInput for indices and weights that do not fit.
        """
        rows, offset, weights = handle_points(self.head, handles)
        first = len(self._terms.skin)
        new = copy.copy(self)
        new._points = sp.csr_array(sp.vstack([self._terms.points, rows]))
        new._offset = new._offset_of_tissue = np.vstack([self._terms.offset, offset])
        new._system = self._without_handles.with_points(rows[:, self._free])
        pick = sp.eye_array(first + handles.count, format="csr")[first:]
        new._handles, new._held = SoftRows(pick, weights), handles.skin
        new._soft, new._partings = {}, {}
        return new.with_detail(self._detail)

    def with_detail(self, detail: FloatArray | float) -> ForwardSimulation:
        """The same simulation of a skin that carries a detail (n, 3) mm of its own on top of what tissue does.

        Characteristics, handles and contacts are those of the whole skin. It takes the place of any other detail.
        """
        new = copy.copy(self)
        new._detail = detail
        if isinstance(detail, np.ndarray):
            detail = check_points("detail", detail, len(self.head.skin), "vertex of the skin")
            first, held = len(self._terms.skin), len(self._held)
            new._offset = self._offset_of_tissue.copy()
            new._offset[:first] += detail[self._terms.skin]
            new._offset[first : first + held] += detail[self._held]
        else:
            new._offset = self._offset_of_tissue
        return new

    def __call__(
        self,
        gradients: FloatArray,
        bones: Bones,
        scale: float = 1.0,
        characteristics: Characteristics | None = None,
        handles: FloatArray | None = None,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        collisions: bool = True,
    ) -> ForwardState:
        """Apply gradients (t, 3, 3) and the motions of bones, translations times `scale` = BB(T) / BB(S).

        handles: (h, 3) mm, where those of `with_handles` should go; without it they are loose.
        gravity: (3,) in 1/mm, a *change*, from `materials.weight_change`: the gradients are an equilibrium that
        contains the weight under which the expression was recorded.
        collisions: False leaves lips where they are, whatever the settings.
        Where the solve fails, `info.status` is FAILED and head and bones are at rest.
        Raises InvalidInput for what does not fit or is not finite, and for handles more than 150 mm from rest.
        """
        wanted, force = self._check_gradients(gradients), check_gravity("gravity", gravity)
        moved = np.empty_like(self.head.vertices)
        moved[self._fixed] = place_bones(self.head, bones, scale)  # section 3.3.2, forward simulation, step 1
        load = self._tissue.divergence(wanted) + 0.5 * self._mass * force
        rhs = load[self._free] - self._from_fixed @ moved[self._fixed]
        if not np.isfinite(rhs).all():
            raise InvalidInput("forward simulation: expected finite gradients and bones, got NaN or infinity.")
        moved[self._free] = self._system.free(rhs)

        goals = self._terms.goals(characteristics or Characteristics())
        targets = goals.targets
        if handles is not None:
            pulled = check_points("handles", handles, len(self._handles.weights), "handle of `with_handles`")
            check_moves("handles", pulled, self._handles.operator @ (self._points @ self.head.vertices + self._offset))
            targets = np.vstack([targets, pulled])
        problem = SoftProblem(self._points @ moved + self._offset, targets, goals.ratios)
        soft = self._soft_system(goals, handles is not None)
        solution = self._solve(soft, problem)  # step 2
        run = _Run(solution, self._system.shifts(solution.forces))
        if self._lips and collisions:
            with _libraries().limit(limits=1, user_api="blas"):  # small matrices: threads wait for each other
                done, lips = self._resolve(self._lips, soft, problem, run, moved)  # step 3
        else:
            done, lips = self._formed(run, moved), LipReport()
        return self._state(done, wanted, carry_bones(self.head, bones, scale), lips)  # eq. (10)

    def _check_gradients(self, gradients: FloatArray) -> FloatArray:
        wanted = np.asarray(gradients, dtype=np.float64)
        if wanted.shape != (len(self.shape.tets), 3, 3):
            raise InvalidInput(
                f"gradients: expected ({len(self.shape.tets)}, 3, 3), one for each tet of the template both heads "
                f"share, got {wanted.shape}."
            )
        return wanted

    def _soft_system(self, goals: Goals, handles: bool) -> SoftSystem:
        """The dense system of the terms in use; made when a combination is met first."""
        key = (*goals.active, "handles") if handles else goals.active
        if key not in self._soft:
            count = len(self._offset)
            fixed, areas = self._terms.rows(goals)
            fixed = SoftRows.stack([fixed, self._handles] if handles else [fixed], count)
            self._soft[key] = SoftSystem(self._system, fixed, SoftRows.stack([areas], count))
        return self._soft[key]

    def _solve(self, soft: SoftSystem, problem: SoftProblem, start: FloatArray | None = None) -> CondensedSolution:
        return soft.solve(problem, self.settings.area_iterations, self.settings.area_tolerance, start)

    def _formed(self, run: _Run, free: FloatArray) -> _Formed:
        """The head of a run, from the vertices `free` (v, 3) mm without forces."""
        moved = free
        if run.solution.forces.any():
            moved = free.copy()
            moved[self._free] += self._system.pulled(run.solution.forces)
        return _Formed(run, moved, self.head.template.embedding @ moved + self.head.residual + self._detail)

    def _resolve(
        self, lips: Lips, soft: SoftSystem, problem: SoftProblem, run: _Run, free: FloatArray
    ) -> tuple[_Formed, LipReport]:
        """Part the lips where they are in each other and solve again; `free` (v, 3) mm are the vertices without forces.

        # differs from the paper: which moves both sides to their average position, once. There is where forces balance
        if both lips are equally soft; prescribed, it folds skin whose points hang on the same tets, and new ones meet.
        Lips that are still in each other are parted on their way from rest, as far as that goes, and the least deep
        result is taken if it leaves less than WORTH of the depth. Otherwise the lips stay as they were without
        contacts: forces that cannot part them pull skin apart beside them.
        """
        rules, place = self.settings, self._terms.place[lips.vertices]
        points, direct = (problem.points + run.shifts)[place], None
        if lips.meet(points):  # seldom wrong, and then the head with crossed lips need not be formed
            direct = self._parting(lips, soft).directly(points, rules.collision_rounds)
            parted = self._formed(self._apart(soft, problem, run, place, direct.forces), free)
            left = lips.depth(parted.skin)
            if left <= ACCEPTED:
                crossed = parted.skin.copy()  # their depth does not depend on the skin around them
                crossed[lips.vertices] = points
                before = lips.depth(crossed)
                if before > SHALLOW:  # or hardly
                    before = lips.depth(self._formed(run, free).skin)
                return parted, LipReport.of(before, left, direct)
        done, best = self._formed(run, free), None
        before = after = lips.depth(done.skin)
        if before <= ACCEPTED:
            return done, LipReport(before, after)
        if direct and left < WORTH * before:
            done, after, best = parted, left, direct
        for tried in self._parting(lips, soft).along(points, rules.collision_rounds):
            parted = self._formed(self._apart(soft, problem, run, place, tried.forces), free)
            left = lips.depth(parted.skin)
            if left < min(after, WORTH * before) and tried.way >= rules.least_way:
                done, after, best = parted, left, tried
            if after <= ACCEPTED:
                break
        report = LipReport.of(before, after, best) if best else LipReport(before, after)
        solution = done.run.solution
        if (after > ACCEPTED or report.way < 1) and solution.status is Status.CONVERGED:
            done = replace(done, run=replace(done.run, solution=replace(solution, status=Status.MAX_ITERATIONS)))
        return done, report

    def _parting(self, lips: Lips, soft: SoftSystem) -> Parting:
        """Made when lips meet first under the terms of `soft`."""
        if soft not in self._partings:
            place = self._terms.place[lips.vertices]
            compliance, stiffness = soft.compliance(place), self.settings.collision_stiffness
            rest = self.head.skin[lips.vertices]
            self._partings[soft] = Parting(lips.gaps, lips.samples, lips.floor, rest, compliance, stiffness)
        return self._partings[soft]

    def _apart(self, soft: SoftSystem, problem: SoftProblem, run: _Run, place: IntArray, forces: FloatArray) -> _Run:
        """A run under forces (p, 3) at the lips, from one without."""
        contact = np.zeros_like(problem.points)
        contact[place] = forces
        shifts = self._system.shifts(contact)
        shifted = replace(problem, points=problem.points + shifts)
        found = self._solve(soft, shifted, run.solution.goal)
        # Their energy without the contacts' potential, which is the same in every iteration.
        rest = self._system.shifts(found.forces)
        work = float(np.vdot(contact, shifts + 2 * rest))
        energy = tuple(e + work for e in found.energy)
        return _Run(replace(found, forces=contact + found.forces, energy=energy), shifts + rest)

    def _state(self, done: _Formed, wanted: FloatArray, bones: Bones, lips: LipReport) -> ForwardState:
        moved, solution = done.vertices, done.run.solution
        head = self.head
        tissue, gradients = self._tissue(moved, wanted)
        if not np.isfinite(tissue) or solution.status is Status.FAILED:
            rest = np.broadcast_to(np.eye(3), gradients.shape).copy()
            finite = np.isfinite([tissue, *solution.energy]).all()
            message = "a plain iteration on areas raised the energy" if finite else "the result is not finite"
            info = SolveInfo(Status.FAILED, 0, (), message)
            return ForwardState(head.vertices.copy(), head.skin.copy(), rest, at_rest(head), info)
        free = tissue - float(np.vdot(solution.forces, done.run.shifts))  # of x0
        energy = tuple(free + e for e in solution.energy)
        message = ""
        if lips.rounds or lips.after > ACCEPTED:
            message = f"lips: {lips.contacts} contacts up to {lips.before:.2f} mm deep, {lips.after:.2f} mm left"
        if lips.way < 1:
            message += f"; held where they could last be parted, after {100 * lips.way:.0f} % of their way"
        info = SolveInfo(solution.status, max(len(energy) - 1, 1), energy, message)
        return ForwardState(moved, done.skin, gradients, bones, info, lips)
