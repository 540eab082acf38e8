"""Section 3.5: target examples as expressions of the source."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.embedding import AnimationSpan, embed_examples
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import Patches, Ridge, whole_mesh
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.types import FloatArray, Pair
from tests.synthetic import ball, expressions, head, regions

SOURCE, TARGET = head(1), head(2)
FACES = ball()[1]
ANIMATION = expressions(1, 12)
NO_RIDGE = Ridge(1e-12)
WHOLE, TWELVE = whole_mesh(len(SOURCE)), contiguous_patches(FACES, len(SOURCE), 12)


def transfer(source: FloatArray, target: FloatArray) -> DeformationTransfer:
    return DeformationTransfer.of(Pair(FACES, source, target, regions()), Weighting.AREA)


@pytest.mark.parametrize("patches", [WHOLE, TWELVE], ids=["whole", "patches"])
def test_what_lies_in_the_span_is_reproduced(patches: Patches) -> None:
    weights = np.random.default_rng(0).normal(size=(3, 12))
    inside = SOURCE + np.tensordot(weights, ANIMATION - SOURCE, axes=1)
    np.testing.assert_allclose(AnimationSpan(SOURCE, ANIMATION, patches, NO_RIDGE)(inside), inside, atol=1e-5)


def test_the_result_lies_in_the_span_and_is_the_nearest_there() -> None:
    embedded = embed_examples(expressions(2, 3), ANIMATION, SOURCE, transfer(TARGET, SOURCE), WHOLE, NO_RIDGE)
    shapes = (ANIMATION - SOURCE).reshape(12, -1)
    carried = (transfer(TARGET, SOURCE)(expressions(2, 3)) - SOURCE).reshape(3, -1)
    weights, *_ = np.linalg.lstsq(shapes.T, carried.T, rcond=None)  # eq. (21) by another solver
    np.testing.assert_allclose((embedded - SOURCE).reshape(3, -1), weights.T @ shapes, atol=1e-5)


@pytest.mark.parametrize("patches", [WHOLE, TWELVE], ids=["whole", "patches"])
def test_a_target_equal_to_the_source_returns_its_own_examples(patches: Patches) -> None:
    own = ANIMATION[:4]
    embedded = embed_examples(own, ANIMATION, SOURCE, transfer(SOURCE, SOURCE), patches, NO_RIDGE)
    np.testing.assert_allclose(embedded, own, atol=1e-5)


def test_no_examples_give_none_and_ask_for_no_transfer() -> None:
    def never(frames: FloatArray) -> FloatArray:
        raise AssertionError("there is nothing to transfer")

    nothing = np.empty((0, *SOURCE.shape))
    assert embed_examples(nothing, ANIMATION, SOURCE, never, TWELVE).shape == nothing.shape


def test_another_topology_is_refused() -> None:
    with pytest.raises(InvalidInput, match="target_examples: expected 642 vertices"):
        embed_examples(expressions(2, 3)[:, 1:], ANIMATION, SOURCE, transfer(TARGET, SOURCE), WHOLE, NO_RIDGE)
