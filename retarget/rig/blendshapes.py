"""Linear blendshapes fitted by ridge regression, per mesh (LBS) or per patch (PLBS): AnaConDaR eqs (1)-(3).

The source's expression is rebuilt from the source's examples, and the same weights blend the target's examples. For a
patch p of n_p vertices let B_p (3 n_p, k) hold the displacements S_j - S of the examples and D_p (t, 3 n_p) those of
the frames. The weights of all frames at once are

    W_p = D_p B_p (B_p^T B_p + r_p I)^-1,   one Cholesky factor per patch, the rest matrix products.

Eq. (2) sums over the vertices, so the same lambda weighs 80 times more on one of 80 patches than on the whole mesh.
Here the residual is by default a mean over vertices, r_p = n_p lambda, so that lambda_reg (mm^2) means the same for
any patch and any resolution. `Ridge` also holds the convention of the paper, by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from retarget.check import InvalidInput, UnsupportedProblem, check_frames, check_vertices
from retarget.suggest import choose
from retarget.types import Examples, FloatArray, IntArray, Pair, RetargetProblem

CHUNK = 16  # frames at a time: keeps the work in the cache
NO_CORRESPONDENCE = "the source's counterparts of the target examples are unknown"

Patches = Sequence[IntArray]  # vertex indices; together they hold every vertex exactly once


class Residual(StrEnum):
    """How the squared vertex distances of a fit are put together."""

    MEAN = "mean"  # over the vertices of the patch
    SUM = "sum"  # eq. (2) as printed


@dataclass(frozen=True)
class Ridge:
    """The regulariser lambda_reg ||w||^2 of eq. (2).

    lambda_reg is in squared units of `length_mm` millimetres: 1 for mm, 10 for cm. The paper prints 0.01 without a
    unit and sums over vertices: ``Ridge(0.01, Residual.SUM, length_mm=10)`` with our assumption of centimetres.
    Raises InvalidInput unless lambda_reg and length_mm are positive and finite.
    """

    lambda_reg: float
    residual: Residual | str = Residual.MEAN
    length_mm: float = 1.0

    def __post_init__(self) -> None:
        for name in ("lambda_reg", "length_mm"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise InvalidInput(f"{name}: expected a positive number, got {value}.")
        choose("residual", self.residual, Residual)

    def diagonal(self, vertex_count: int) -> float:
        """r_p in mm^2: what the diagonal of B^T B gains for a patch of vertex_count vertices."""
        return self.lambda_reg * self.length_mm**2 * (vertex_count if self.residual == Residual.MEAN else 1)


def whole_mesh(vertex_count: int) -> Patches:
    """One patch that holds all vertices: LBS."""
    return (np.arange(vertex_count),)


class Blendshapes:
    """The displacements of k examples (k, n, 3) from a neutral (n, 3), in mm, by patch. k may be 0."""

    def __init__(self, neutral: FloatArray, examples: FloatArray, patches: Patches) -> None:
        self.neutral = check_vertices("neutral", neutral)
        examples = check_frames("examples", examples, len(self.neutral))
        self.patches = patches
        self.count = len(examples)
        self.deltas = tuple(_flat(examples[:, patch] - self.neutral[patch]) for patch in patches)  # (k, 3 n_p) each

    def blend(self, weights: Sequence[FloatArray]) -> FloatArray:
        """Eqs (1) and (3): frames (t, n, 3) in mm from weights (t, k) for each patch."""
        frames = np.empty((len(weights[0]), *self.neutral.shape))
        for patch, deltas, w in zip(self.patches, self.deltas, weights, strict=True):
            frames[:, patch] = self.neutral[patch] + (w @ deltas).reshape(len(w), len(patch), 3)
        return frames


class RidgeFit:
    """Eq. (2): the weights that bring blendshapes closest to given frames; factorised once."""

    def __init__(self, blendshapes: Blendshapes, ridge: Ridge) -> None:
        self.blendshapes = blendshapes
        identity = np.eye(blendshapes.count)
        self._factors = [
            cho_factor(deltas @ deltas.T + ridge.diagonal(len(patch)) * identity) if blendshapes.count else None
            for patch, deltas in zip(blendshapes.patches, blendshapes.deltas, strict=True)
        ]

    def weights(self, frames: FloatArray) -> list[FloatArray]:
        """(t, k) without unit for each patch, for frames (t, n, 3) in mm."""
        shapes = self.blendshapes
        return [
            _solve(factor, deltas @ _flat(frames[:, patch] - shapes.neutral[patch]).T)
            for factor, patch, deltas in zip(self._factors, shapes.patches, shapes.deltas, strict=True)
        ]


@dataclass(frozen=True)
class Retargeted:
    """What blendshapes make of source frames: both (t, n, 3) in mm."""

    source: FloatArray  # S_i^L or S_i^P: what the source's examples explain of the frames
    target: FloatArray  # T_i^L or T_i^P: the same weights on the target's examples


class BlendshapeTransfer:
    """Eqs (1)-(3) for corresponding examples (k, n, 3) of source and target, in mm."""

    def __init__(
        self,
        source_neutral: FloatArray,
        source_examples: FloatArray,
        target_neutral: FloatArray,
        target_examples: FloatArray,
        patches: Patches,
        ridge: Ridge,
    ) -> None:
        self.source = Blendshapes(source_neutral, source_examples, patches)
        self.target = Blendshapes(target_neutral, target_examples, patches)
        if self.source.count != self.target.count:
            raise InvalidInput(
                f"examples: expected one source example for each of the {self.target.count} target examples, "
                f"got {self.source.count}."
            )
        self._fit = RidgeFit(self.source, ridge)

    def __call__(self, source_frames: FloatArray) -> Retargeted:
        """Source frames (t, n, 3) in mm, rebuilt and retargeted."""
        source_frames = check_frames("source_frames", source_frames, len(self.source.neutral))
        result = Retargeted(np.empty_like(source_frames), np.empty_like(source_frames))
        for start in range(0, len(source_frames), CHUNK):
            part = slice(start, start + CHUNK)
            weights = self._fit.weights(source_frames[part])
            result.source[part] = self.source.blend(weights)
            result.target[part] = self.target.blend(weights)
        return result


def projection(
    neutral: FloatArray, examples: FloatArray, frames: FloatArray, patches: Patches, ridge: Ridge
) -> FloatArray:
    """The best fit of a character's own examples (k, n, 3) to its frames (t, n, 3), in mm.

    With the target's examples and the truth this is the projection bound of LBS or PLBS: what remains is motion that
    no blending of these examples can show.
    """
    blendshapes = Blendshapes(neutral, examples, patches)
    frames = check_frames("frames", frames, len(blendshapes.neutral))
    return blendshapes.blend(RidgeFit(blendshapes, ridge).weights(frames))


def blendshapes_of(pair: Pair, examples: Examples, patches: Patches, ridge: Ridge) -> BlendshapeTransfer:
    """The transfer for a pair; raises UnsupportedProblem without source examples. Without any examples at all it
    gives the two neutrals.
    """
    if examples.source is None:
        raise UnsupportedProblem(f"blendshapes: {NO_CORRESPONDENCE}.")
    return BlendshapeTransfer(
        pair.source_neutral, examples.source, pair.target_neutral, examples.target, patches, ridge
    )


def without_blendshapes(problem: RetargetProblem) -> str | None:
    """The reason why a method that rests on corresponding blendshapes cannot serve a problem, or None."""
    if problem.source_examples is None:
        return NO_CORRESPONDENCE
    if not len(problem.target_examples):
        return "there are no examples to blend"
    return None


def _flat(points: FloatArray) -> FloatArray:
    return points.reshape(len(points), -1 if points.size else 3 * points.shape[1])


def _solve(factor: tuple[FloatArray, bool] | None, rhs: FloatArray) -> FloatArray:
    return rhs.T if factor is None else cho_solve(factor, rhs).T
