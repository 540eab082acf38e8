"""Local anatomically-constrained retargeting, called ALM (Chandran et al. 2022)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from retarget.artistic import Edits
from retarget.check import InvalidInput, UnsupportedProblem, check_frames
from retarget.rig.blendshapes import NO_CORRESPONDENCE, Residual, without_blendshapes
from retarget.rig.local_model.calibration import calibrated_strengths
from retarget.rig.local_model.layout import OverlappingPatches, check_rings
from retarget.rig.local_model.patch_fit import PatchBlendshapes, PatchCoefficients, PatchFit, PatchFitSettings
from retarget.rig.local_model.preferences import shape_preferences
from retarget.suggest import choose
from retarget.types import (
    Examples,
    FloatArray,
    Pair,
    Retargeter,
    RetargetProblem,
    RetargetResult,
    SolveInfo,
    Status,
)

EDITS = ("patch_weights", "shape_preferences")
LEAST_VERTICES = 8  # of a patch, on average: a coarse mesh has fewer patches than asked for
NO_MOTION = "none of the source's examples differs from its neutral"


@dataclass(frozen=True)
class AnatomicalLocalModels(Retargeter):
    """Patch blendshapes with coupled coefficients (eqs 1, 2, 7-11).

    lambda_reg, lambda_overlap, residual, length_mm: see `PatchFitSettings`. global_rigid: R of eq. (7).
    patch_count, rings, seed: see `OverlappingPatches.of`; a mesh with less than 8 vertices for each patch has fewer.
    calibration: so many of the last examples do not build the models but calibrate a strength for each patch (section
    4.6); at least one is left to build.
    Raises InvalidInput for settings out of range, and from `prepare` for a patch_count that the mesh cannot have.
    """

    lambda_reg: float
    lambda_overlap: float
    residual: Residual | str = Residual.MEAN
    length_mm: float = 1.0
    global_rigid: bool = True
    patch_count: int = 400
    rings: int = 6
    seed: int = 0
    calibration: int = 0

    def __post_init__(self) -> None:
        self._fit_settings  # noqa: B018  # raises for settings out of range
        check_rings(self.rings)
        if self.calibration < 0:
            raise InvalidInput(f"calibration: expected 0 or more of the examples, got {self.calibration}.")

    def unsupported(self, problem: RetargetProblem) -> str | None:
        if reason := without_blendshapes(problem):
            return reason
        assert problem.source_examples is not None
        return self._without_shapes(problem.source_neutral, problem.source_examples)

    def prepare(self, pair: Pair) -> _Prepared:
        vertices = len(pair.source_neutral)
        count = min(self.patch_count, max(vertices // LEAST_VERTICES, 1))
        layout = OverlappingPatches.of(pair.faces, vertices, count, self.rings, self.seed)
        return _Prepared(self, pair, layout)

    @property
    def _fit_settings(self) -> PatchFitSettings:
        return PatchFitSettings(self.lambda_reg, self.lambda_overlap, self.residual, self.length_mm, self.global_rigid)

    def _without_shapes(self, neutral: FloatArray, examples: FloatArray) -> str | None:
        """The reason why these source examples build no model, or None."""
        if len(examples) <= self.calibration:
            return f"{self.calibration} of {len(examples)} examples calibrate and none is left to build the models"
        if not (examples[: len(examples) - self.calibration] != neutral).any():
            return NO_MOTION
        return None


@dataclass(frozen=True)
class _Prepared:
    method: AnatomicalLocalModels
    pair: Pair
    layout: OverlappingPatches

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        """Raises UnsupportedProblem for examples that build no model."""
        method, pair = self.method, self.pair
        if examples.source is None:
            raise UnsupportedProblem(f"alm: {NO_CORRESPONDENCE}.")
        if reason := method._without_shapes(pair.source_neutral, examples.source):
            raise UnsupportedProblem(f"alm: {reason}.")
        build = slice(0, examples.count - method.calibration)
        source = PatchBlendshapes(pair.source_neutral, examples.source[build], self.layout)
        target = PatchBlendshapes(pair.target_neutral, examples.target[build], self.layout)
        fit = PatchFit(source, method._fit_settings)
        rest = slice(build.stop, None)
        strengths = calibrated_strengths(target, fit(examples.source[rest]).alpha, examples.target[rest])
        return _Fitted(method, pair, target, fit, strengths)


@dataclass(frozen=True)
class _Fitted:
    method: AnatomicalLocalModels
    pair: Pair
    target: PatchBlendshapes
    patches: PatchFit
    strengths: FloatArray  # (P,) of the calibration

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        """Edits: `patch_weights` {region or patch: factor} and `shape_preferences`, see that module."""
        frames = check_frames("source_frames", source_frames, len(self.pair.source_neutral))
        fit, strengths = self._directed({} if edits is None else edits)
        found = fit(frames)
        source = fit.shapes.blend(found.alpha)
        rebuilt = (source - found.shift[:, None]) @ found.rotation  # back to where the frame was
        target = self.target.blend(found.alpha * strengths[:, None])
        return RetargetResult(target, _verdicts(found), {"source_reconstruction": rebuilt, "patches": target})

    def _directed(self, edits: Mapping[str, Any]) -> tuple[PatchFit, FloatArray]:
        for name in edits:
            choose("edits", name, EDITS)
        regions, cores = self.pair.regions, self.target.layout.cores
        fit, strengths = self.patches, self.strengths
        if "patch_weights" in edits:
            strengths = strengths * Edits.of({"patch_weights": edits["patch_weights"]}, regions, cores).strengths
        if "shape_preferences" in edits:
            gamma = shape_preferences(edits["shape_preferences"], self.target.count, regions, cores)
            fit = PatchFit(fit.shapes, fit.settings, gamma)
        return fit, strengths


def _verdicts(found: PatchCoefficients) -> tuple[SolveInfo, ...]:
    return tuple(
        SolveInfo(Status.CONVERGED if moved < 1e-3 else Status.MAX_ITERATIONS, iterations, (), "")
        for iterations, moved in zip(found.iterations, found.moved, strict=True)
    )
