"""The two baselines are the operator with one weighting each."""

import numpy as np
import pytest

from baselines.surface_deformation_transfer import SurfaceDeformationTransfer
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from tests.synthetic import problem


@pytest.mark.parametrize(("method", "weighting"), [(SurfaceDeformationTransfer(w), w) for w in Weighting])
def test_uses_its_weighting_and_the_cranium(method, weighting):
    given = problem()
    frames = given.source_animation
    expected = DeformationTransfer.of(given.pair, weighting)(frames)
    np.testing.assert_array_equal(method.retarget(given, frames).frames, expected)
    moved = (expected - given.target_neutral)[:, given.regions.vertices["cranium"]]
    np.testing.assert_allclose(moved.mean(axis=1), 0, atol=1e-12)
