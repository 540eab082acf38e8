"""Deformation transfer of surfaces: Sumner and Popovic 2004, or the area-weighted form of Botsch et al. 2006."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from retarget.check import check_no_edits
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.suggest import choose
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetResult, SolveInfo


@dataclass(frozen=True)
class SurfaceDeformationTransfer(Retargeter):
    """T_i = dt(S_i, S, T); needs no examples.

    weighting: `uniform` counts every triangle once, with a free fourth vertex (Sumner and Popovic 2004, the method
    `sumner_popovic`); `area` weights gradients on the vertices alone by the triangles' areas on the target (Botsch et
    al. 2006, the method `gradient_transfer`). Raises InvalidInput for another one.
    """

    needs_examples: ClassVar[bool] = False
    exact_on_self: ClassVar[bool] = True

    weighting: Weighting | str

    def __post_init__(self) -> None:
        choose("weighting", self.weighting, Weighting)

    def prepare(self, pair: Pair) -> _Prepared:
        return _Prepared(DeformationTransfer.of(pair, self.weighting))


@dataclass(frozen=True)
class _Prepared:
    transfer: DeformationTransfer

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        return _Fitted(self.transfer)


@dataclass(frozen=True)
class _Fitted:
    transfer: DeformationTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits("deformation transfer", edits)
        frames = self.transfer(source_frames)
        return RetargetResult(frames, (SolveInfo(),) * len(frames))
