"""Landmark-guided deformation transfer (Onizuka et al. 2019), the variant that AnaConDaR compares with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from retarget.check import check_no_edits
from retarget.rig.landmark_transfer import LandmarkTransfer, LandmarkWeights, lacking
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetProblem, RetargetResult, SolveInfo


@dataclass(frozen=True)
class LandmarkDeformationTransfer(LandmarkWeights, Retargeter):
    """T_i by deformation transfer with landmarks; needs no examples. The settings are those of `LandmarkWeights`.

    Exact on itself with the regularity `correction` alone.
    """

    needs_examples: ClassVar[bool] = False
    exact_on_self: ClassVar[bool] = True

    def unsupported(self, problem: RetargetProblem) -> str | None:
        return lacking(problem.faces, len(problem.source_neutral), problem.regions)

    def prepare(self, pair: Pair) -> _Prepared:
        return _Prepared(LandmarkTransfer(pair, self))


@dataclass(frozen=True)
class _Prepared:
    transfer: LandmarkTransfer

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        return _Fitted(self.transfer)


@dataclass(frozen=True)
class _Fitted:
    transfer: LandmarkTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits("landmark-guided deformation transfer", edits)
        frames = self.transfer(source_frames)
        return RetargetResult(frames, (SolveInfo(),) * len(frames))
