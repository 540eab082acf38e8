"""Deformation transfer in the form of Botsch et al. 2006: gradients on the vertices alone, weighted by area."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from retarget.check import check_no_edits
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetResult, SolveInfo


@dataclass(frozen=True)
class GradientTransfer(Retargeter):
    """T_i = dt(S_i, S, T) with triangles weighted by their area on the target; needs no examples."""

    exact_on_self: ClassVar[bool] = True

    def prepare(self, pair: Pair) -> _Prepared:
        return _Prepared(DeformationTransfer.of(pair, Weighting.AREA))


@dataclass(frozen=True)
class _Prepared:
    transfer: DeformationTransfer

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        return _Fitted(self.transfer)


@dataclass(frozen=True)
class _Fitted:
    transfer: DeformationTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits("gradient transfer", edits)
        frames = self.transfer(source_frames)
        return RetargetResult(frames, (SolveInfo(),) * len(frames))
