"""Linear blendshapes (LBS): one set of blending weights for the whole mesh (AnaConDaR eqs 1-3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from retarget.check import check_no_edits
from retarget.rig.blendshapes import (
    BlendshapeTransfer,
    Residual,
    Ridge,
    blendshapes_of,
    whole_mesh,
    without_blendshapes,
)
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetProblem, RetargetResult, SolveInfo


@dataclass(frozen=True)
class LinearBlendshapes(Retargeter):
    """T_i^L = T + sum_j w_ij (T_j - T), with the weights that rebuild S_i from the source's examples.

    lambda_reg regularises the weights, in squared units of length_mm millimetres; the squared distances are a mean or
    a sum over the vertices. See `retarget.rig.blendshapes.Ridge`. Raises InvalidInput for a lambda_reg <= 0.
    """

    lambda_reg: float
    residual: Residual | str = Residual.MEAN
    length_mm: float = 1.0

    def __post_init__(self) -> None:
        self._ridge()

    def unsupported(self, problem: RetargetProblem) -> str | None:
        return without_blendshapes(problem)

    def prepare(self, pair: Pair) -> _Prepared:
        return _Prepared(pair, self._ridge())

    def _ridge(self) -> Ridge:
        return Ridge(self.lambda_reg, self.residual, self.length_mm)


@dataclass(frozen=True)
class _Prepared:
    pair: Pair
    ridge: Ridge

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        patches = whole_mesh(len(self.pair.source_neutral))
        return _Fitted(blendshapes_of(self.pair, examples, patches, self.ridge))


@dataclass(frozen=True)
class _Fitted:
    blendshapes: BlendshapeTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits("linear blendshapes", edits)
        blended = self.blendshapes(source_frames)
        parts = {"source_reconstruction": blended.source, "lbs": blended.target}
        return RetargetResult(blended.target, (SolveInfo(),) * len(blended.target), parts)
