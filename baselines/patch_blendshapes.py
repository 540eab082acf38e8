"""Patchwise linear blendshapes (PLBS): blending weights of their own for each patch (AnaConDaR section 3.2.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from retarget.check import check_no_edits
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import BlendshapeTransfer, Patches, Residual, Ridge, blendshapes_of, without_blendshapes
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetProblem, RetargetResult, SolveInfo


@dataclass(frozen=True)
class PatchBlendshapes(Retargeter):
    """Eqs (1)-(3) independently for each of patch_count contiguous, non-overlapping METIS patches.

    lambda_reg regularises the weights, in squared units of length_mm millimetres; the squared distances are a mean or
    a sum over the vertices of a patch. See `retarget.rig.blendshapes.Ridge`. Raises InvalidInput for a
    lambda_reg <= 0, and from `prepare` for a patch_count that the mesh cannot have.
    """

    lambda_reg: float
    residual: Residual | str = Residual.MEAN
    length_mm: float = 1.0
    patch_count: int = 80
    seed: int = 0

    def __post_init__(self) -> None:
        self._ridge()

    def unsupported(self, problem: RetargetProblem) -> str | None:
        return without_blendshapes(problem)

    def prepare(self, pair: Pair) -> _Prepared:
        patches = contiguous_patches(pair.faces, len(pair.source_neutral), self.patch_count, self.seed)
        return _Prepared(pair, patches, self._ridge())

    def _ridge(self) -> Ridge:
        return Ridge(self.lambda_reg, self.residual, self.length_mm)


@dataclass(frozen=True)
class _Prepared:
    pair: Pair
    patches: Patches
    ridge: Ridge

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        return _Fitted(blendshapes_of(self.pair, examples, self.patches, self.ridge))


@dataclass(frozen=True)
class _Fitted:
    blendshapes: BlendshapeTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits("patchwise blendshapes", edits)
        blended = self.blendshapes(source_frames)
        parts = {"source_reconstruction": blended.source, "plbs": blended.target}
        return RetargetResult(blended.target, (SolveInfo(),) * len(blended.target), parts)
