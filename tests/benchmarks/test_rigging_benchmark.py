"""Example-based facial rigging and landmark-guided deformation transfer at the size of a study."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.rig.deformation_transfer import DeformationTransfer
from retarget.rig.ebfr import EbfrSettings, ExampleBasedRigging, Generic
from retarget.rig.landmark_transfer import LANDMARKS, LandmarkTransfer, LandmarkWeights
from retarget.types import FloatArray, Pair, Regions
from tests.benchmarks.test_methods_benchmark import perform, sphere_grid

SHAPES, EXAMPLES = 51, 15
SETTINGS = EbfrSettings()


@pytest.fixture(scope="module")
def heads_17k() -> Pair:
    """Two neutrals of 17,002 vertices and 34,000 triangles, with landmarks anywhere on the front."""
    source, faces = sphere_grid(100, 170)
    target = source * [1.1, 0.95, 1.0] + 3 * np.sin(source[:, [1, 2, 0]] / 20)
    front = np.flatnonzero(source[:, 2] > 40)
    picked = np.random.default_rng(0).choice(front, len(LANDMARKS), replace=False)
    back = np.flatnonzero(source[:, 2] < -60)
    marks = {name: int(vertex) for name, vertex in zip(LANDMARKS, picked, strict=True)}
    return Pair(faces, source, target, Regions(vertices={"cranium": back}, landmarks=marks))


@pytest.fixture(scope="module")
def rig_17k(heads_17k: Pair) -> tuple[ExampleBasedRigging, Generic, FloatArray, FloatArray]:
    rigging = ExampleBasedRigging(DeformationTransfer.of(heads_17k, "uniform"))
    shapes, own = perform(heads_17k.source_neutral, SHAPES, 0), perform(heads_17k.target_neutral, SHAPES, 1)
    weights = np.random.default_rng(2).uniform(0, 1, (EXAMPLES, SHAPES))
    examples = heads_17k.target_neutral + np.tensordot(weights, own - heads_17k.target_neutral, axes=1)
    return rigging, rigging.generic(shapes, SETTINGS), examples, weights


@pytest.mark.benchmark(group="EBFR of one identity, 51 shapes, 15 examples, 17k vertices")
def test_rig_of_one_identity(benchmark, heads_17k):
    shapes = perform(heads_17k.source_neutral, SHAPES, 0)
    examples = perform(heads_17k.target_neutral, EXAMPLES, 1)

    def rig() -> None:
        rigging = ExampleBasedRigging(DeformationTransfer.of(heads_17k, "uniform"))
        rigging.rig(rigging.generic(shapes, SETTINGS), examples, SETTINGS)

    benchmark.pedantic(rig, rounds=1)


@pytest.mark.benchmark(group="EBFR of a further set of examples, 51 shapes, 15 examples, 17k vertices")
def test_rig_of_a_further_set(benchmark, rig_17k):
    rigging, generic, examples, weights = rig_17k
    benchmark.pedantic(rigging.rig, (generic, examples, SETTINGS, weights), rounds=3)


@pytest.mark.benchmark(group="landmark-guided deformation transfer, set-up, 17k vertices")
def test_landmark_transfer_set_up(benchmark, heads_17k):
    benchmark.pedantic(LandmarkTransfer, (heads_17k, LandmarkWeights()), rounds=2)


@pytest.mark.benchmark(group="landmark-guided deformation transfer, one expression, 17k vertices")
def test_landmark_transfer_one_expression(benchmark, heads_17k):
    frames = perform(heads_17k.source_neutral, 1, 0)
    benchmark(LandmarkTransfer(heads_17k, LandmarkWeights()), frames)
