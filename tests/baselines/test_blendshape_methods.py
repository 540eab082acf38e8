"""LBS, PLBS and the two controls against each other and against the formulas."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.linear_blendshapes import LinearBlendshapes
from baselines.patch_blendshapes import PatchBlendshapes
from baselines.surface_deformation_transfer import SurfaceDeformationTransfer
from baselines.transferred_residual import TransferredResidual
from retarget.check import InvalidInput
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from tests.synthetic import problem as synthetic_problem


@pytest.fixture(scope="module")
def problem():
    return synthetic_problem()


def test_one_patch_is_the_whole_mesh(problem):
    frames = problem.source_animation
    lbs = LinearBlendshapes(0.1).retarget(problem, frames)
    plbs = PatchBlendshapes(0.1, patch_count=1).retarget(problem, frames)
    np.testing.assert_allclose(plbs.frames, lbs.frames, atol=1e-9)
    control = TransferredResidual(0.1, patch_count=None).retarget(problem, frames)
    np.testing.assert_array_equal(control.parts["lbs"], lbs.frames)


def test_an_example_maps_to_its_counterpart(problem):
    for method in (LinearBlendshapes(1e-9), PatchBlendshapes(1e-9), TransferredResidual(1e-9, patch_count=80)):
        frames = method.retarget(problem, problem.source_examples).frames
        np.testing.assert_allclose(frames, problem.target_examples, atol=1e-3)


def test_published_lambda_weighs_on_each_patch_alike_whatever_its_size(problem):
    """Summed over a patch, lambda = 0.01 cm^2 is 1 / n_p mm^2 per vertex: 80 patches feel it 80 times as much."""
    frames = problem.source_animation[5:]
    paper = LinearBlendshapes(0.01, residual="sum", length_mm=10.0).retarget(problem, frames).frames
    per_vertex = LinearBlendshapes(1 / len(problem.source_neutral)).retarget(problem, frames).frames
    np.testing.assert_allclose(paper, per_vertex, atol=1e-9)


@pytest.mark.parametrize("form", list(Weighting))
@pytest.mark.parametrize("patch_count", [None, 20])
def test_control_is_blendshapes_plus_the_transferred_rest(problem, form, patch_count):
    frames = problem.source_animation
    result = TransferredResidual(0.05, patch_count, deformation_transfer=form).retarget(problem, frames)
    blended = result.parts["lbs" if patch_count is None else "plbs"]
    np.testing.assert_allclose(result.parts["source_reconstruction"] + result.parts["missing_source"], frames)
    transfer = DeformationTransfer.of(problem.pair, form)
    missing = transfer(problem.source_neutral + result.parts["missing_source"]) - problem.target_neutral
    np.testing.assert_allclose(result.parts["missing_target"], missing, atol=1e-12)
    np.testing.assert_allclose(result.frames, blended + missing, atol=1e-12)


def test_with_useless_examples_the_control_is_deformation_transfer(problem):
    still = replace(
        problem,
        source_examples=np.repeat(problem.source_neutral[None], 3, axis=0),
        target_examples=np.repeat(problem.target_neutral[None], 3, axis=0),
    )
    frames = problem.source_animation
    control = TransferredResidual(0.01, patch_count=20).retarget(still, frames).frames
    np.testing.assert_allclose(control, SurfaceDeformationTransfer("area").retarget(problem, frames).frames, atol=1e-9)


def test_settings_are_checked_when_they_are_made():
    with pytest.raises(InvalidInput, match="lambda_reg"):
        LinearBlendshapes(-1.0)
    with pytest.raises(InvalidInput, match="residual"):
        PatchBlendshapes(1.0, residual="max")
    with pytest.raises(InvalidInput, match="deformation_transfer: 'rigid' is unknown, expected one of uniform, area"):
        TransferredResidual(1.0, None, deformation_transfer="rigid")


def test_an_impossible_patch_count_is_refused(problem):
    with pytest.raises(InvalidInput, match="expected a count between 1"):
        PatchBlendshapes(1.0, patch_count=10_000).retarget(problem, problem.source_animation)
