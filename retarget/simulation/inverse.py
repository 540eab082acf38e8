"""The inverse simulation invSim of eq. (8): what soft tissue, muscle and bones of a head do to form an expression.

Bones are placed first, by rigid fits; then eq. (14) is minimised over all other vertices by projective dynamics.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import repeat
from typing import Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from retarget.anatomy.head import Head
from retarget.check import InvalidInput, check_frames, check_points, check_vertices
from retarget.simulation.bones import Jaw, at_rest, check_moves, fit_bones, place_bones
from retarget.simulation.local_step import paper_energy
from retarget.simulation.materials import check_gravity, check_stiffness
from retarget.simulation.projections import closest_rotation
from retarget.simulation.projective_dynamics import (
    LENGTH_UNIT,
    Equilibrium,
    Problem,
    ProjectiveDynamics,
    SolverSettings,
    TissueWeights,
    tissue_weights,
)
from retarget.simulation.soft_terms import Handles, handle_points
from retarget.simulation.state import Bones, HeadState
from retarget.simulation.surface import carried_by_skin, vertex_areas
from retarget.simulation.tetrahedra import deformation_gradients, rest_shape, vertex_volumes
from retarget.simulation.weights import PAPER_SKIN, tet_of_weight_one
from retarget.suggest import choose
from retarget.types import FloatArray, Status

EPSILON = 1e-9  # of the predictor's least squares, relative to the largest change


@dataclass(frozen=True)
class InverseSettings:
    """Weights of eq. (14), the form of eq. (13), and the solver's tolerances."""

    w_soft: float = 1.0  # w_S of Table 3
    w_muscle: float = 1.0  # w_M of Table 3
    w_target: float = 100.0  # w_tar of Table 3
    muscle_strain: float = 0.05  # see `tissue_weights`
    surface: Literal["soft", "hard"] = "soft"  # hard: see `surface.carried_by_skin`
    jaw: Jaw | str = Jaw.FREE
    history: int = 6  # expressions that `stream` predicts the next one from
    solver: SolverSettings = field(default_factory=lambda: SolverSettings(energy_tolerance=1e-3, bounded_end=True))

    def __post_init__(self) -> None:
        choose("surface", self.surface, ("soft", "hard"))
        choose("jaw", self.jaw, Jaw)
        if not (np.isfinite(self.w_target) and self.w_target > 0 and self.history >= 1):
            raise InvalidInput(
                "InverseSettings: expected a finite w_target > 0 and history >= 1, "
                f"got {self.w_target} and {self.history}."
            )


_Known = tuple[FloatArray, FloatArray]  # vertices (n, 3) mm and what their targets were, (k, 3) mm


@dataclass(frozen=True)
class _Posed:
    """An expression as the solver takes it."""

    bones: Bones
    targets: FloatArray  # (k, 3) mm
    fixed: FloatArray  # (c, 3) mm


class InverseSimulation:
    """invSim of eq. (8) for one head, with everything made that does not depend on the expression."""

    def __init__(
        self,
        head: Head,
        settings: InverseSettings | None = None,
        stiffness: ArrayLike = 1.0,
        handles: Handles | None = None,
    ) -> None:
        """stiffness: factors (t,) > 0 of the tets' weights, or one number; see `materials.region_stiffness`.

        handles are points with targets of their own in every call.
        Raises InvalidInput for what does not fit, NotPositiveDefinite if neither bone nor skin holds the head.
        """
        self.head, self.settings = head, settings or InverseSettings()
        template, rules = head.template, self.settings
        self.shape = rest_shape(head.vertices, template.tets)
        factors = check_stiffness(stiffness, len(self.shape.tets))
        weights = tissue_weights(self.shape, template.muscle, rules.w_soft, rules.w_muscle, rules.muscle_strain)
        self.weights = TissueWeights(weights.strain * factors, weights.volume * factors)

        fixed = template.fixed
        if rules.surface == "hard":
            self._outer, self._carry = carried_by_skin(head)
            fixed = np.union1d(fixed, self._outer)
        self._handle_count, self._handle_offset = 0, np.empty((0, 3))
        operators, pulls = [], []
        if rules.surface == "soft":
            operators.append(template.embedding)
            pulls.append(self._target_weights())
        if handles is not None:
            rows, self._handle_offset, pull = handle_points(head, handles)
            self._handle_count = handles.count
            operators.append(rows)
            pulls.append(pull * LENGTH_UNIT**2)
        self.solver = ProjectiveDynamics(
            self.shape,
            self.weights,
            fixed,
            sp.csr_array(sp.vstack(operators)) if operators else None,
            np.concatenate(pulls) if pulls else 0.0,
            rules.solver,
        )
        self._mass = vertex_volumes(self.shape)

    def _target_weights(self) -> FloatArray:
        """w_tar of eq. (14) for each skin vertex: the paper's total, spread by area; see `weights`."""
        areas = vertex_areas(self.head.skin, self.head.template.faces)
        total = self.settings.w_target * PAPER_SKIN * tet_of_weight_one(self.head)
        weights: FloatArray = total * areas / areas.sum()
        return weights

    def __call__(
        self,
        skin: FloatArray,
        near: HeadState | None = None,
        handles: FloatArray | None = None,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> HeadState:
        """The head that forms the expression `skin` (n, 3) mm; `near` is a solved one to start from, if not rest.

        handles: (h, 3) mm, where those of the constructor should go. gravity: (3,) in 1/mm, a *change*, from
        `materials.weight_change`. Where the solve fails, `info.status` is FAILED and head and bones are at rest.
        Raises InvalidInput for what does not fit or is not finite, for skin that is not stabilised or opens the jaw
        too far, and for vertices and handles more than 150 mm from rest.
        """
        posed = self._pose(skin, handles)
        known = None if near is None else (near.vertices, self._seen(near.vertices))
        return self._state(posed, self.solver.solve_many([self._problem(posed, known, gravity)])[0])  # eq. (8)

    def batch(
        self,
        skins: FloatArray,
        size: int = 16,
        handles: FloatArray | None = None,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> list[HeadState]:
        """Expressions (b, n, 3) mm, each from rest and independent of the others, `size` in one back-substitution.

        handles: (h, 3) mm for all expressions, or (b, h, 3). gravity: (3,) for all. Raises InvalidInput as a call
        does, for any expression before the first is solved; the message names its index.
        """
        frames = check_frames("expressions", skins, len(self.head.skin))
        if handles is not None and handles.ndim == 3 and len(handles) != len(frames):
            raise InvalidInput(f"handles: expected (h, 3), or {len(frames)} of these, got {len(handles)}.")
        posed = list(self._poses(frames, handles))
        states = []
        for first in range(0, len(posed), size):
            some = posed[first : first + size]
            solved = self.solver.solve_many([self._problem(p, None, gravity) for p in some])
            states += [self._state(*pair) for pair in zip(some, solved, strict=True)]
        return states

    def stream(
        self,
        skins: Iterable[FloatArray],
        handles: FloatArray | Iterable[FloatArray] | None = None,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        near: Iterable[HeadState | None] | None = None,
    ) -> Iterator[HeadState]:
        """An animation, one expression (n, 3) mm at a time, each predicted from those before it.

        The prediction is the affine combination of the last expressions that comes closest on the skin, to which the
        solver adds the harmonic extension of what is left.

        near: for each frame a state of this head in almost that expression, or None: its change since the frame
        before, and its distance from the last result, join the combination. For anacon that is adt's result. It is
        drawn after the frame's expression, and changes the number of iterations, not what they converge to.
        handles: (h, 3) mm for all frames, or as many of these as frames. gravity: (3,) for all. A frame that fails is
        at rest and the next one goes on. Raises InvalidInput as a call does; the message names the frame's index, and
        the stream ends there: repair or leave out the frame and start a stream with what follows.
        """
        known: deque[_Known] = deque(maxlen=self.settings.history)
        known.append((self.head.vertices, self._seen(self.head.vertices)))
        guesses: Iterator[HeadState | None] = repeat(None) if near is None else iter(near)
        before: _Known | None = None
        for posed in self._poses(skins, handles):
            guess = next(guesses, None)
            hint = None if guess is None else (guess.vertices, self._seen(guess.vertices))
            start = self._predicted(known, posed, before, hint)
            before = hint
            found = self.solver.solve_many([self._problem(posed, start, gravity)])[0]
            if found.info.status is not Status.FAILED:
                known.append((found.vertices, posed.targets))
            yield self._state(posed, found)

    def paper_energy(self, state: HeadState) -> float:
        """Eqs (11) and (12) as printed, tets weighted as in eq. (14) and by volume in cm^3."""
        rotations = closest_rotation(state.gradients)
        return paper_energy(state.gradients, rotations, self.weights.strain, self.weights.volume)

    def _poses(
        self, skins: Iterable[FloatArray], handles: FloatArray | Iterable[FloatArray] | None
    ) -> Iterator[_Posed]:
        goals: Iterator[FloatArray | None]
        if handles is None or (isinstance(handles, np.ndarray) and handles.ndim == 2):
            goals = repeat(handles)
        else:
            goals = iter(handles)
        for number, skin in enumerate(skins):
            try:
                posed = self._pose(skin, next(goals, None))
            except InvalidInput as error:
                raise InvalidInput(f"frame {number}: {error}") from error
            yield posed

    def _pose(self, skin: FloatArray, handles: FloatArray | None) -> _Posed:
        """Step 1 of section 3.3.2, and the targets of step 2."""
        head, template = self.head, self.head.template
        skin = check_vertices("expression", skin, len(head.skin))
        bones = fit_bones(head, skin, self.settings.jaw)
        if (handles is None) != (self._handle_count == 0):
            raise InvalidInput(
                f"handles: this simulation was made with {self._handle_count}, expected a target (3,) mm for each of "
                f"them, got {'none' if handles is None else len(handles)}."
            )
        targets = [skin - head.residual] if self.settings.surface == "soft" else []  # eq. (13) through the embedding
        if handles is not None:
            pulled = check_points("handles", handles, self._handle_count, "handle") - self._handle_offset
            check_moves("handles", pulled, self._seen(head.vertices)[-self._handle_count :])
            targets.append(pulled)
        moved = head.vertices.copy()
        if self.settings.surface == "hard":
            moved[self._outer] += self._carry @ (skin - head.skin)
        moved[template.fixed] = place_bones(head, bones)
        return _Posed(bones, np.vstack([np.empty((0, 3)), *targets]), moved[self.solver.fixed])

    def _seen(self, vertices: FloatArray) -> FloatArray:
        """(k, 3) mm: where the points that have targets are."""
        return self.solver.seen(vertices)

    def _problem(self, posed: _Posed, near: tuple[FloatArray, FloatArray] | None, gravity: ArrayLike) -> Problem:
        force = check_gravity("gravity", gravity)
        forces = self._mass[:, None] * force if force.any() else None
        return Problem(posed.targets, posed.fixed, near=near, forces=forces)

    def _state(self, posed: _Posed, found: Equilibrium) -> HeadState:
        head = self.head
        bones = at_rest(head) if found.info.status is Status.FAILED else posed.bones
        skin = head.template.embedding @ found.vertices + head.residual
        return HeadState(found.vertices, skin, deformation_gradients(self.shape, found.vertices), bones, found.info)

    def _predicted(
        self, known: deque[_Known], posed: _Posed, earlier: _Known | None = None, hint: _Known | None = None
    ) -> _Known:
        """The affine combination of known (vertices, targets) closest in targets, or in fixed vertices without any; a
        hint and its change since an earlier one take part."""
        vertices, last = known[-1]
        fixed = self.solver.fixed
        before = [(shape - vertices, goal - last) for shape, goal in list(known)[:-1]]
        if hint is not None:
            before += [(hint[0] - there[0], hint[1] - there[1]) for there in (known[-1], earlier) if there is not None]
        if not before:
            return vertices, last
        changes = np.stack([(goal if last.size else shape[fixed]).ravel() for shape, goal in before])
        wanted = (posed.targets - last if last.size else posed.fixed - vertices[fixed]).ravel()
        products = changes @ changes.T
        ridge = EPSILON * np.trace(products) + np.finfo(float).tiny
        weights = np.linalg.solve(products + ridge * np.eye(len(products)), changes @ wanted)
        combined, seen = vertices.copy(), last.copy()
        for weight, (shape, goal) in zip(weights, before, strict=True):
            combined += weight * shape
            seen += weight * goal
        return combined, seen
