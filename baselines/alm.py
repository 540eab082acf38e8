"""Local anatomically-constrained retargeting, called ALM (Chandran et al. 2022)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from retarget.anatomical_transfer import joined, without_template
from retarget.anatomy.distance import Surface
from retarget.anatomy.template import check_size
from retarget.artistic import Edits
from retarget.character import Character, Topology
from retarget.check import InvalidInput, UnsupportedProblem, check_frames
from retarget.rig.blendshapes import NO_CORRESPONDENCE, Residual, without_blendshapes
from retarget.rig.local_model.anatomical import AnatomicalLocalModel, ReconstructionSettings
from retarget.rig.local_model.calibration import calibrated_strengths
from retarget.rig.local_model.layout import OverlappingPatches, check_rings
from retarget.rig.local_model.patch_fit import PatchBlendshapes, PatchFit, PatchFitSettings
from retarget.rig.local_model.preferences import shape_preferences
from retarget.rig.local_model.skin_over_bone import SkinOverBone, cranial_bone, vertices_over_cranium
from retarget.suggest import choose
from retarget.types import Examples, FloatArray, IntArray, Pair, Retargeter, RetargetProblem, RetargetResult

EDITS = ("patch_weights", "shape_preferences")
LEAST_VERTICES = 8  # of a patch, on average: a coarse mesh has fewer patches than asked for
NO_MOTION = "none of the source's examples differs from its neutral"


@dataclass(frozen=True)
class AnatomicalLocalModels(Retargeter):
    """Patch blendshapes with coupled coefficients (eqs 1, 2, 7-11), then the target's anatomical local model (3-6, 12).

    anatomical: do the second step; without it the patches are put together as they are (`OverlappingPatches`).
    template: `coarse` or `paper`, size of the head whose skull the second step reads.
    lambda_data, lambda_anatomy, lambda_stitch: see `ReconstructionSettings`.
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
    anatomical: bool = True
    template: str = "coarse"
    lambda_data: float = 10.0
    lambda_anatomy: float = 10.0
    lambda_stitch: float = 0.85

    def __post_init__(self) -> None:
        self._fit_settings, self._reconstruction_settings  # noqa: B018  # raise for settings out of range
        check_size(self.template)
        check_rings(self.rings)
        if self.calibration < 0:
            raise InvalidInput(f"calibration: expected 0 or more of the examples, got {self.calibration}.")

    def unsupported(self, problem: RetargetProblem) -> str | None:
        if reason := without_blendshapes(problem):
            return reason
        if self.anatomical and (reason := without_template(problem, self.template)):
            return reason
        assert problem.source_examples is not None
        return self._without_shapes(problem.source_neutral, problem.source_examples)

    def prepare(self, pair: Pair) -> _Prepared:
        vertices = len(pair.source_neutral)
        count = min(self.patch_count, max(vertices // LEAST_VERTICES, 1))
        layout = OverlappingPatches.of(pair.faces, vertices, count, self.rings, self.seed)
        if not self.anatomical:
            return _Prepared(self, pair, layout)
        topology = Topology.of(pair.faces, pair.regions)
        head = Character.of(topology, self.template, pair.target_neutral).head
        return _Prepared(self, pair, layout, (vertices_over_cranium(head), cranial_bone(head)))

    @property
    def _fit_settings(self) -> PatchFitSettings:
        return PatchFitSettings(self.lambda_reg, self.lambda_overlap, self.residual, self.length_mm, self.global_rigid)

    @property
    def _reconstruction_settings(self) -> ReconstructionSettings:
        return ReconstructionSettings(self.lambda_data, self.lambda_anatomy, self.lambda_stitch)

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
    bone: tuple[IntArray, Surface] | None = None  # skin vertices over bone, and the bone of the target

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
        return _Fitted(method, pair, target, fit, strengths, self._model(examples.target[build]))

    def _model(self, shapes: FloatArray) -> AnatomicalLocalModel | None:
        if self.bone is None:
            return None
        neutral = self.pair.target_neutral
        bone = SkinOverBone.of(np.concatenate([neutral[None], shapes]), *self.bone)
        return AnatomicalLocalModel(neutral, shapes, self.layout, bone, self.method._reconstruction_settings)


@dataclass(frozen=True)
class _Fitted:
    method: AnatomicalLocalModels
    pair: Pair
    target: PatchBlendshapes
    patches: PatchFit
    strengths: FloatArray  # (P,) of the calibration
    model: AnatomicalLocalModel | None

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        """Edits: `patch_weights` {region or patch: factor}, and `shape_preferences`, which its module describes."""
        frames = check_frames("source_frames", source_frames, len(self.pair.source_neutral))
        fit, strengths = self._directed({} if edits is None else edits)
        found = fit(frames)
        source = fit.shapes.blend(found.alpha)
        alpha = found.alpha * strengths[:, None]  # section 3.2, artistic control
        patches = self.target.blend(alpha)
        parts = {
            "source_reconstruction": (source - found.shift[:, None]) @ found.rotation,  # back to where the frame was
            "patches": patches,
        }
        if self.model is None:
            return RetargetResult(patches, found.info, parts)
        solved = [self.model(self.target.at_places(a), a) for a in alpha]
        surfaces = np.array([surface for surface, _ in solved]).reshape(frames.shape)
        info = tuple(
            joined({"patches": first, "anatomy": second}) for first, (_, second) in zip(found.info, solved, strict=True)
        )
        return RetargetResult(surfaces, info, parts)

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
