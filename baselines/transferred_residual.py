"""Blendshapes plus the part they cannot explain, moved by deformation transfer: controls that the paper lacks.

AnaConDaR eqs (4)-(6) with plain deformation transfer for adt and without anacon. Whatever AnaConDaR gains over these
rows is due to its anatomy; whatever they gain over the blendshapes is due to the missing delta blendshape alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from retarget.check import check_no_edits
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import (
    BlendshapeTransfer,
    Patches,
    Residual,
    Ridge,
    blendshapes_of,
    whole_mesh,
    without_blendshapes,
)
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.suggest import choose
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetProblem, RetargetResult, SolveInfo


@dataclass(frozen=True)
class TransferredResidual(Retargeter):
    """T_i = T_i^B + dt(S + S_i - S_i^B, S, T) - T, where B blends on patches, or on the whole mesh without them.

    patch_count: contiguous METIS patches, or None for the whole mesh (LBS).
    deformation_transfer: `area` (Botsch et al. 2006) or `uniform` (Sumner and Popovic 2004).
    lambda_reg, residual, length_mm: see `retarget.rig.blendshapes.Ridge`.
    Raises InvalidInput for settings out of range, and from `prepare` for a patch_count that the mesh cannot have.
    """

    control: ClassVar[bool] = True
    exact_on_self: ClassVar[bool] = True

    lambda_reg: float
    patch_count: int | None
    residual: Residual | str = Residual.MEAN
    length_mm: float = 1.0
    deformation_transfer: Weighting | str = Weighting.AREA
    seed: int = 0

    def __post_init__(self) -> None:
        self._ridge()
        choose("deformation_transfer", self.deformation_transfer, Weighting)

    def unsupported(self, problem: RetargetProblem) -> str | None:
        return without_blendshapes(problem)

    def prepare(self, pair: Pair) -> _Prepared:
        n = len(pair.source_neutral)
        if self.patch_count is None:
            kind, patches = "lbs", whole_mesh(n)
        else:
            kind, patches = "plbs", contiguous_patches(pair.faces, n, self.patch_count, self.seed)
        transfer = DeformationTransfer.of(pair, self.deformation_transfer)
        return _Prepared(pair, patches, self._ridge(), transfer, kind)

    def _ridge(self) -> Ridge:
        return Ridge(self.lambda_reg, self.residual, self.length_mm)


@dataclass(frozen=True)
class _Prepared:
    pair: Pair
    patches: Patches
    ridge: Ridge
    transfer: DeformationTransfer
    kind: str

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        blendshapes = blendshapes_of(self.pair, examples, self.patches, self.ridge)
        return _Fitted(self.pair, blendshapes, self.transfer, self.kind)


@dataclass(frozen=True)
class _Fitted:
    pair: Pair
    blendshapes: BlendshapeTransfer
    transfer: DeformationTransfer
    kind: str

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits(f"{self.kind} with a transferred residual", edits)
        blended = self.blendshapes(source_frames)
        missing_source = source_frames - blended.source  # eq. (4)
        # differs from the paper: eq. (5) with plain deformation transfer for adt
        missing_target = self.transfer.displacements(self.pair.source_neutral + missing_source)
        frames = blended.target + missing_target  # differs from the paper: eq. (6) without anacon
        parts = {
            "source_reconstruction": blended.source,
            self.kind: blended.target,
            "missing_source": missing_source,
            "missing_target": missing_target,
        }
        return RetargetResult(frames, (SolveInfo(),) * len(frames), parts)
