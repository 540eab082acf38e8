"""Example-based facial rigging (Li, Weise and Pauly 2010): personal blendshapes from generic ones and a few examples.

A generic rig has a neutral A_0 and blendshapes A_i, the character a neutral B_0 and examples F_j whose blending weights
alpha_ij are roughly known. Wanted are the character's own blendshapes B_i. With the deformation gradients X_i of B_i,
X*_i of A_i and Y_j of F_j against their neutrals (less the identity, without unit), two steps alternate:

    A   for each triangle   min  sum_j || Y_j - sum_i alpha_ij X_i ||^2 + beta sum_i w_i || X_i - X*_i ||^2
    B   for each example    min  || F_j - B_0 - sum_i alpha_ij (B_i - B_0) ||^2 + gamma || alpha_j - alpha*_j ||^2

with w_i = ((1 + m_i) / (kappa + m_i))^theta, m_i = || X*_i ||: what the generic rig leaves still should stay still.
beta and gamma fall from one alternation to the next. After A the vertices are integrated from the gradients by the
Poisson system of deformation transfer, which copies X*_i; so without examples it is deformation transfer.

Step A couples the blendshapes of a triangle by as many rows as there are examples. With R = Y - alpha X* and the
diagonal W of all w_i its solution is

    X = X* + W^-1 alpha^T C,    (beta 1 + alpha W^-1 alpha^T) C = R,

a small positive definite system for each triangle, whatever the number of blendshapes. Where there are more examples
than blendshapes they are rotated first: alpha = Q A with orthonormal Q leaves as many rows as blendshapes.

The duals C and the residuals of step B also say what any further expression of the generic character becomes, as if it
had been a blendshape too: see `Alternation.follow`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import lsq_linear

from retarget.check import InvalidInput, check_frames
from retarget.geometry.triangles import fourth_edges, gradient_operators
from retarget.rig.blendshapes import Residual, Ridge
from retarget.rig.deformation_transfer import DeformationTransfer
from retarget.types import FloatArray, IntArray

BoolArray = NDArray[np.bool_]

CHUNK = 8  # blendshapes at a time: what a solve of the Poisson system likes best
TRIANGLES = 4096  # at a time: their small systems stay in the cache


@dataclass(frozen=True)
class EbfrSettings:
    """beta, gamma: of the first and the last alternation, linear in between; gamma and the regulariser lambda_reg of
    weights that are not given are in squared units of length_mm millimetres (see `Ridge`), beta is without unit.
    kappa, theta: of w_i; kappa without unit, it is compared with a deformation gradient.
    bounded: weights of step B lie in [0, 1].
    Raises InvalidInput for values out of range.
    """

    beta_first: float = 0.5
    beta_last: float = 0.1
    gamma_first: float = 1000.0
    gamma_last: float = 100.0
    alternations: int = 5
    kappa: float = 0.1
    theta: float = 2.0
    bounded: bool = True
    lambda_reg: float = 1e-3
    residual: Residual | str = Residual.MEAN
    length_mm: float = 1.0

    def __post_init__(self) -> None:
        for name in ("beta_first", "beta_last", "kappa"):
            if not 0 < getattr(self, name) < np.inf:
                raise InvalidInput(f"{name}: expected a positive number, got {getattr(self, name)}.")
        if not 0 <= self.theta < np.inf:
            raise InvalidInput(f"theta: expected a number of at least 0, got {self.theta}.")
        if not isinstance(self.alternations, int) or self.alternations < 1:
            raise InvalidInput(f"alternations: expected a whole number of at least 1, got {self.alternations}.")
        for value in (self.gamma_first, self.gamma_last, self.lambda_reg):
            self.ridge(value)

    def ridge(self, strength: float) -> Ridge:
        return Ridge(strength, self.residual, self.length_mm)

    def schedule(self) -> Iterator[tuple[float, Ridge]]:
        """beta and gamma of each alternation."""
        for at in np.linspace(0, 1, self.alternations):
            beta = (1 - at) * self.beta_first + at * self.beta_last
            yield beta, self.ridge((1 - at) * self.gamma_first + at * self.gamma_last)


@dataclass(frozen=True)
class Generic:
    """Expressions of the generic character, prepared once for all examples of the other."""

    moved: FloatArray  # (s, n, 3) mm: displacements
    fourth: FloatArray  # (s, f, 3): changes of fourth edges
    transferred: FloatArray  # (s, n, 3) mm: displacements by deformation transfer
    yielding: FloatArray  # (s, f): 1 / w_i

    def __getitem__(self, part: slice) -> Generic:
        return Generic(self.moved[part], self.fourth[part], self.transferred[part], self.yielding[part])


@dataclass(frozen=True)
class Weighting:
    """Step B solved: the weights of any blendshape, by the conditions of optimality."""

    residuals: FloatArray  # (j, n, 3) mm
    strength: float  # mm^2
    bounded: bool

    def __call__(self, shapes: FloatArray, prior: FloatArray | float = 0.0) -> FloatArray:
        """(j, s) for displacements (s, n, 3) mm of blendshapes and what their weights are held to."""
        weights: FloatArray = prior + _flat(self.residuals) @ _flat(shapes).T / self.strength
        return weights.clip(0, 1) if self.bounded else weights


def blending_weights(
    shapes: FloatArray,
    targets: FloatArray,
    ridge: Ridge,
    prior: FloatArray | None = None,
    bounded: bool = False,
    used: BoolArray | None = None,
) -> tuple[FloatArray, Weighting]:
    """Step B: the weights (j, s) of displacements (s, n, 3) mm that come closest to (j, n, 3) mm and to `prior`.

    used: (s,) which of them may explain the targets; the others weigh nothing.
    """
    weights, strength = np.zeros((len(targets), len(shapes))), ridge.diagonal(shapes.shape[1])
    which = np.arange(len(shapes)) if used is None else np.flatnonzero(used)
    flat, wanted = _flat(shapes), _flat(targets)
    if len(which) and len(targets):
        rhs = (wanted @ flat.T)[:, which] + (0 if prior is None else strength * prior[:, which])
        system = (flat @ flat.T)[np.ix_(which, which)] + strength * np.eye(len(which))
        factor, lower = cho_factor(system, lower=True)
        found = cho_solve((factor, lower), rhs.T).T
        if bounded:
            half = np.tril(factor).T
            for j in np.flatnonzero((found < 0).any(axis=1) | (found > 1).any(axis=1)):
                found[j] = lsq_linear(half, half @ found[j], bounds=(0, 1), method="bvls").x
        weights[:, which] = found
    residuals = (wanted - weights @ flat).reshape(targets.shape)
    return weights, Weighting(residuals, strength, bounded)


@dataclass(frozen=True)
class Correction:
    """Step A solved: what the gradients of any blendshape gain over those of the generic one."""

    duals: FloatArray  # (r, 9 f): C, by row
    rotation: FloatArray | None  # (j, r): Q, or None for the identity

    def __call__(self, weights: FloatArray, yielding: FloatArray) -> FloatArray:
        """(s, f, 3, 3) for weights (j, s) of blendshapes and their 1 / w_i (s, f)."""
        rows = weights if self.rotation is None else self.rotation.T @ weights
        changes: FloatArray = (rows.T @ self.duals).reshape(*yielding.shape, 3, 3)
        changes *= yielding[..., None, None]
        return changes


@dataclass(frozen=True)
class Alternation:
    """Both steps in turn, the last of them an A."""

    rigging: ExampleBasedRigging
    weights: FloatArray  # (j, s) of the blendshapes in the last step A
    prior: FloatArray  # (j, s): alpha*
    steps: tuple[tuple[Correction, Weighting | None], ...]
    misfit: tuple[float, ...]  # mm: mean distance of the examples to their blends, after each step B

    def follow(self, generic: Generic, prior: FloatArray) -> FloatArray:
        """Displacements (t, n, 3) mm of the character for expressions of the generic one.

        prior (j, t) holds what their weights in the examples are held to. An expression among the blendshapes becomes
        what it became in the alternation; any other one what it would have, had the examples been explained the same.
        """
        moved = np.empty_like(generic.transferred)
        for start in range(0, len(moved), CHUNK):
            part = slice(start, start + CHUNK)
            few, held = generic[part], prior[:, part]
            weights, shapes = held, few.transferred
            for correct, weigh in self.steps:
                shapes = self.rigging.corrected(few, correct, weights)
                weights = weights if weigh is None else weigh(shapes, held)
            moved[part] = shapes
        return moved


@dataclass(frozen=True)
class PersonalRig:
    """Blendshapes of the character's own, and how they make its examples."""

    shapes: FloatArray  # (s, n, 3) mm
    weights: FloatArray  # (j, s)
    misfit: tuple[float, ...]  # mm: mean distance of the examples to their blends, after each step B


class ExampleBasedRigging:
    """The alternation for a pair of neutrals, on the factor of its deformation transfer (generic -> own)."""

    def __init__(self, transfer: DeformationTransfer) -> None:
        self.transfer = transfer
        self._generic = _Gradients(transfer.source, transfer.faces)
        self._own = _Gradients(transfer.target, transfer.faces)

    def generic(self, shapes: FloatArray, settings: EbfrSettings) -> Generic:
        """Expressions (s, n, 3) mm of the generic character; s may be 0. Raises InvalidInput for another topology."""
        shapes = check_frames("shapes", shapes, len(self.transfer.source))
        moved, fourth = self._generic.motions(shapes)
        size = np.empty(fourth.shape[:2])
        for i in range(len(shapes)):
            size[i] = np.linalg.norm(self._generic(moved[i : i + 1], fourth[i : i + 1])[0], axis=(1, 2))
        # differs from the paper: the gradient's norm, not that of M = X V, which has the length of an edge
        yielding = ((settings.kappa + size) / (1 + size)) ** settings.theta
        return Generic(moved, fourth, self.transfer.displacements(shapes), yielding)

    def alternate(
        self,
        generic: Generic,
        examples: FloatArray,
        prior: FloatArray,
        settings: EbfrSettings,
        used: BoolArray | None = None,
    ) -> Alternation:
        """Fit to examples (j, n, 3) mm with the weights (j, s) that they are thought to have; j may be 0.

        used: (s,) which blendshapes may explain them, all by default; the prior of the others is 0. Raises
        InvalidInput for arrays that do not fit together.
        """
        examples = check_frames("examples", examples, len(self.transfer.target))
        if prior.shape != (len(examples), len(generic.moved)):
            raise InvalidInput(
                f"weights: expected one for each of {len(examples)} examples and {len(generic.moved)} blendshapes, "
                f"got {prior.shape}."
            )
        if not prior.size:
            return Alternation(self, prior, prior, (), ())
        moved, fourth = self._own.motions(examples)
        schedule = list(settings.schedule())
        steps: list[tuple[Correction, Weighting | None]] = []
        weights, misfit = prior, []
        for number, (beta, gamma) in enumerate(schedule, 1):
            correct = self._step_a(generic, moved, fourth, weights, beta)
            if number == len(schedule):
                steps.append((correct, None))
                break
            shapes = self._shapes(generic, correct, weights)
            weights, weigh = blending_weights(shapes, moved, gamma, prior, settings.bounded, used)
            misfit.append(_mean_distance(weigh.residuals))
            steps.append((correct, weigh))
        return Alternation(self, weights, prior, tuple(steps), tuple(misfit))

    def rig(
        self, generic: Generic, examples: FloatArray, settings: EbfrSettings, weights: FloatArray | None = None
    ) -> PersonalRig:
        """The character's blendshapes from examples (j, n, 3) mm and their estimated weights (j, s); j may be 0.

        Without weights they are fitted with the blendshapes of deformation transfer. Raises InvalidInput for arrays
        that do not fit together.
        """
        examples = check_frames("examples", examples, len(self.transfer.target))
        moved = examples - self.transfer.target
        if weights is None:
            ridge = settings.ridge(settings.lambda_reg)
            weights, _ = blending_weights(generic.transferred, moved, ridge, bounded=settings.bounded)
        done = self.alternate(generic, examples, np.asarray(weights, dtype=np.float64), settings)
        if not done.steps:
            return PersonalRig(self.transfer.target + generic.transferred, done.weights, ())
        shapes = self._shapes(generic, done.steps[-1][0], done.weights)
        gamma = settings.ridge(settings.gamma_last)
        weights, last = blending_weights(shapes, moved, gamma, done.prior, settings.bounded)
        return PersonalRig(self.transfer.target + shapes, weights, (*done.misfit, _mean_distance(last.residuals)))

    def corrected(self, generic: Generic, correct: Correction, weights: FloatArray) -> FloatArray:
        """Displacements (s, n, 3) mm of blendshapes with weights (j, s) after step A."""
        changes = correct(weights, generic.yielding)
        return generic.transferred + self.transfer.integrate(changes, generic.moved)

    def _shapes(self, generic: Generic, correct: Correction, weights: FloatArray) -> FloatArray:
        shapes = np.empty_like(generic.transferred)
        for start in range(0, len(shapes), CHUNK):
            part = slice(start, start + CHUNK)
            shapes[part] = self.corrected(generic[part], correct, weights[:, part])
        return shapes

    def _step_a(
        self, generic: Generic, moved: FloatArray, fourth: FloatArray, weights: FloatArray, beta: float
    ) -> Correction:
        """Step A for displacements (j, n, 3) mm of the examples and changes (j, f, 3) of their fourth edges."""
        rotation, rows = None, weights  # Q and A
        if len(weights) > weights.shape[1]:
            rotation, rows = np.linalg.qr(weights)
            moved, fourth = _blend(rotation.T, moved), _blend(rotation.T, fourth)
        count, triangles = len(rows), generic.yielding.shape[1]
        missing = self._own(moved, fourth)  # R = Y - alpha X*, (r, f, 3, 3)
        missing -= self._generic(_blend(rows, generic.moved), _blend(rows, generic.fourth))
        missing = missing.reshape(count, triangles, 9)
        first, second = np.tril_indices(count)
        pairs = rows[first] * rows[second]  # (r (r + 1) / 2, s): the lower triangle of each alpha W^-1 alpha^T
        for start in range(0, triangles, TRIANGLES):
            part = slice(start, start + TRIANGLES)
            _solve_each(pairs @ generic.yielding[:, part], beta, missing[:, part])
        return Correction(missing.reshape(count, -1), rotation)


class _Gradients:
    """Deformation gradients against one neutral (n, 3) mm, less the identity."""

    def __init__(self, neutral: FloatArray, faces: IntArray) -> None:
        self._neutral, self._faces = neutral, faces
        self._fourth = fourth_edges(neutral, faces)
        self._gradient, self._normal = gradient_operators(neutral, faces)

    def motions(self, frames: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Displacements (t, n, 3) mm and changes (t, f, 3) of fourth edges."""
        fourth = np.empty((len(frames), *self._faces.shape))
        for i, frame in enumerate(frames):
            fourth[i] = fourth_edges(frame, self._faces) - self._fourth
        return frames - self._neutral, fourth

    def __call__(self, moved: FloatArray, fourth: FloatArray) -> FloatArray:
        """(t, f, 3, 3) transposed gradients, less the identity."""
        gradients = np.empty((len(moved), len(self._faces), 3, 3))
        for i in range(len(moved)):
            gradients[i] = (self._gradient @ moved[i] + self._normal @ fourth[i]).reshape(-1, 3, 3)
        return gradients


@njit(cache=True, parallel=True)
def _solve_each(lower, beta, rhs):  # type: ignore[no-untyped-def]
    """Solve (beta 1 + S_t) c = rhs[:, t] for each triangle t in place; lower[:, t] is S_t."""
    count, _, columns = rhs.shape
    for t in prange(rhs.shape[1]):
        factor = np.empty((count, count))
        k = 0
        for i in range(count):  # Cholesky, row by row
            for j in range(i + 1):
                value = lower[k, t]
                k += 1
                for m in range(j):
                    value -= factor[i, m] * factor[j, m]
                factor[i, j] = np.sqrt(value + beta) if i == j else value / factor[j, j]
        solution = np.empty((count, columns))
        for i in range(count):
            for c in range(columns):
                value = rhs[i, t, c]
                for m in range(i):
                    value -= factor[i, m] * solution[m, c]
                solution[i, c] = value / factor[i, i]
        for i in range(count - 1, -1, -1):
            for c in range(columns):
                value = solution[i, c]
                for m in range(i + 1, count):
                    value -= factor[m, i] * solution[m, c]
                solution[i, c] = value / factor[i, i]
                rhs[i, t, c] = solution[i, c]


def _blend(weights: FloatArray, arrays: FloatArray) -> FloatArray:
    """(j, m, 3) from weights (j, s) and (s, m, 3)."""
    blended: FloatArray = (weights @ _flat(arrays)).reshape(len(weights), *arrays.shape[1:])
    return blended


def _flat(points: FloatArray) -> FloatArray:
    return points.reshape(len(points), points.shape[1] * 3)


def _mean_distance(residuals: FloatArray) -> float:
    return float(np.linalg.norm(residuals, axis=-1).mean())
