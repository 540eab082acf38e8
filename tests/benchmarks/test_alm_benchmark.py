"""ALM at the size of its paper, 95,000 vertices, 400 patches, 20 shapes, and at that of the default head."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from retarget.geometry.oriented import vertex_normals
from retarget.rig.local_model.anatomical import AnatomicalLocalModel, ReconstructionSettings
from retarget.rig.local_model.layout import OverlappingPatches
from retarget.rig.local_model.patch_fit import PatchBlendshapes, PatchFit, PatchFitSettings
from retarget.rig.local_model.skin_over_bone import SkinOverBone
from retarget.types import FloatArray, IntArray
from tests.benchmarks.test_methods_benchmark import perform, sphere_grid

SHAPES = 19  # and the neutral
PATCHES = 400
SIZES = {"95,002 vertices, 6 rings": (250, 380, 6), "17,002 vertices, 3 rings": (100, 170, 3)}
FIT = PatchFitSettings(lambda_reg=35.0, lambda_overlap=100.0, residual="sum")


class Heads:
    """Two ellipsoids, 20 shapes of each, a frame of the first, and a smaller ellipsoid as bone in the second."""

    def __init__(self, rings: int, sectors: int, overlap: int) -> None:
        self.overlap = overlap
        self.source, self.faces = sphere_grid(rings, sectors)
        self.target: FloatArray = self.source * [1.1, 0.95, 1.0] + np.sin(self.source[:, [1, 2, 0]] / 20)
        self.shapes = perform(self.source, SHAPES, 0), perform(self.target, SHAPES, 1)
        self.frame = perform(self.source, 1, 2)
        inside = self.target - 7.0 * vertex_normals(self.target, self.faces)
        self.bone: tuple[FloatArray, IntArray] = inside, self.faces
        self.over: IntArray = np.flatnonzero(self.target[:, 1] > 0)

    def set_up(self) -> tuple[PatchFit, PatchBlendshapes, AnatomicalLocalModel]:
        """All but the fit of the head."""
        layout = OverlappingPatches.of(self.faces, len(self.source), PATCHES, self.overlap)
        target = PatchBlendshapes(self.target, self.shapes[1], layout)
        fit = PatchFit(PatchBlendshapes(self.source, self.shapes[0], layout), FIT)
        bone = SkinOverBone.of(np.concatenate([self.target[None], self.shapes[1]]), self.over, self.bone)
        settings = ReconstructionSettings()
        return fit, target, AnatomicalLocalModel(self.target, self.shapes[1], layout, bone, settings)


@lru_cache(maxsize=1)
def heads(size: str) -> Heads:
    return Heads(*SIZES[size])


@pytest.mark.benchmark(group="ALM, set-up")
@pytest.mark.parametrize("size", SIZES)
def test_set_up(benchmark, size):
    benchmark.pedantic(heads(size).set_up, rounds=1)


@pytest.mark.benchmark(group="ALM, one frame")
@pytest.mark.parametrize("size", SIZES)
def test_one_frame(benchmark, size):
    fit, target, model = heads(size).set_up()

    def frame():
        alpha = fit(heads(size).frame).alpha[0]
        return model(target.at_places(alpha), alpha)

    _, info = benchmark.pedantic(frame, rounds=5, warmup_rounds=1)
    benchmark.extra_info["iterations"] = info.iterations


@pytest.mark.benchmark(group="ALM, one frame, first step alone")
@pytest.mark.parametrize("size", SIZES)
def test_one_frame_of_patches(benchmark, size):
    fit, target, _ = heads(size).set_up()
    benchmark.pedantic(lambda: target.blend(fit(heads(size).frame).alpha), rounds=5, warmup_rounds=1)
