from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.geometry.triangles import areas
from retarget.rig.deformation_transfer import CHUNK, DeformationTransfer, Weighting
from retarget.types import Pair, Regions
from tests.retarget.rig.literal_deformation_transfer import literal_transfer
from tests.synthetic import ball, cranium, expressions, head, regions

ORACLE = Path(__file__).parents[3] / ".." / "shared" / "data" / "dt_oracle" / "deformation_transfer_oracle.npz"
NO_ANCHORS = np.empty(0, dtype=np.int64)
weightings = pytest.mark.parametrize("weighting", list(Weighting))


def centred(points):
    return points - points.mean(axis=-2, keepdims=True)


@weightings
def test_equals_the_literal_system_with_free_fourth_vertices(weighting):
    source, target, (_, faces) = head(1, 2), head(2, 2), ball(2)
    weights = areas(target, faces) if weighting is Weighting.AREA else np.ones(len(faces))
    transfer = DeformationTransfer(source, target, faces, NO_ANCHORS, weighting)
    for expression in expressions(1, 2, subdivisions=2):
        expected = literal_transfer(source, expression, target, faces, weights)
        np.testing.assert_allclose(centred(transfer(expression[None])[0]), centred(expected), atol=1e-9)


def test_agrees_with_an_independent_implementation():
    if not ORACLE.exists():
        pytest.skip("the oracle of an independent implementation, ../shared/data/dt_oracle, is not here")
    cm = np.load(ORACLE)
    source, target = 10 * cm["source_neutral_cm"], 10 * cm["target_neutral_cm"]
    transfer = DeformationTransfer(source, target, cm["faces"], NO_ANCHORS, Weighting.UNIFORM)
    for name in ("jawOpen", "mouthSmile_L", "eyeBlink_L"):
        expression, peer = 10 * cm[f"source_{name}_cm"], 10 * cm[f"peer_{name}_cm"]
        still = np.linalg.norm(expression - source, axis=1) < 1e-6
        ours = transfer(expression[None])[0]
        peer += (ours - peer)[still].mean(axis=0)
        assert np.linalg.norm(ours - peer, axis=1).max() < 1e-3, name


@weightings
@pytest.mark.parametrize("scale", [1.0, 0.25, 3.0])
@pytest.mark.parametrize("anchored", [True, False])
def test_self_and_scaled_copy_are_exact(weighting, scale, anchored):
    source, (_, faces) = head(1), ball()
    anchors = np.arange(40) if anchored else NO_ANCHORS  # some of them move
    transfer = DeformationTransfer(source, scale * source - 5, faces, anchors, weighting)
    frames = expressions(1, 4) + 2.5
    np.testing.assert_allclose(transfer(frames), scale * (frames - source) + scale * source - 5, atol=1e-9)


@weightings
def test_rotated_target_gets_gradients_in_world_axes(weighting):
    """A gradient is applied as it is: an affine map of the source is the same affine map of any target."""
    source, target, (_, faces) = head(1), head(2), ball()
    affine = Rotation.from_rotvec([0.1, 0.3, 0]).as_matrix()
    transfer = DeformationTransfer(source, target, faces, NO_ANCHORS, weighting)
    moved = transfer((source @ affine.T)[None])[0]
    np.testing.assert_allclose(centred(moved), centred(target @ affine.T), atol=1e-9)


@weightings
def test_neutral_stays_neutral_to_the_bit(weighting):
    source, target, (_, faces) = head(1), head(2), ball()
    transfer = DeformationTransfer(source, target, faces, cranium(), weighting)
    np.testing.assert_array_equal(transfer(source[None])[0], target)


def test_anchors_move_as_in_the_source_times_the_ratio_of_sizes():
    source, target, (_, faces) = head(1), head(2), ball()
    anchors = np.arange(5, 60)
    transfer = DeformationTransfer(source, target, faces, anchors)
    frames = expressions(1, 3)
    wanted = transfer.size_ratio * (frames - source)[:, anchors].mean(axis=1)
    assert np.abs(wanted).max() > 0.1
    np.testing.assert_allclose(transfer.displacements(frames)[:, anchors].mean(axis=1), wanted, atol=1e-12)


def test_anchors_keep_the_translation_of_the_source():
    source, target, (_, faces) = head(1), head(2), ball()
    transfer = DeformationTransfer.of(Pair(faces, source, target, regions()), Weighting.UNIFORM)
    moved = transfer.displacements(expressions(1, 3))[:, cranium()]
    np.testing.assert_allclose(moved.mean(axis=1), 0, atol=1e-12)
    drifting = transfer.displacements(source[None] + [1.0, 2.0, 3.0])[0]
    np.testing.assert_allclose(drifting, np.broadcast_to(transfer.size_ratio * np.array([1.0, 2, 3]), target.shape))


def test_components_are_anchored_each_on_its_own():
    source, target, (_, faces) = head(1), head(2), ball()
    eye, (_, eye_faces) = 12 * ball(2)[0] + [30, 20, 80], ball(2)
    n = len(source)
    lonely = np.array([[0.0, 0, 200]])
    source, target = np.vstack([source, eye, lonely]), np.vstack([target, eye + 3, lonely + 1])
    transfer = DeformationTransfer(source, target, np.vstack([faces, eye_faces + n]), cranium())
    frame = np.vstack([expressions(1, 1)[0], eye + np.array([0, 1.5, 0]), lonely + np.array([2, 0, 0])])
    moved = transfer.displacements(frame[None])[0]
    ratio = transfer.size_ratio
    np.testing.assert_allclose(moved[cranium()].mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(moved[n:-1], np.broadcast_to([0, 1.5 * ratio, 0], eye.shape), atol=1e-10)
    np.testing.assert_allclose(moved[-1], [2 * ratio, 0, 0], atol=1e-12)
    alone = DeformationTransfer(head(1), head(2), faces, cranium()).displacements(expressions(1, 1))[0]
    # only the ratio of the sizes differs between the two meshes, and the anchors do not move
    np.testing.assert_allclose(moved[:n], alone, atol=1e-9)


def test_without_anchors_the_stillest_vertices_hold_the_head():
    source, target, (_, faces) = head(1), head(2), ball()
    frames = expressions(1, 3)
    moved = DeformationTransfer(source, target, faces, NO_ANCHORS).displacements(frames)
    for frame, displacement in zip(frames, moved, strict=True):
        still = np.linalg.norm(frame - source, axis=1) == 0
        assert still.sum() > 0.05 * len(source)
        np.testing.assert_allclose(displacement[still].mean(axis=0), 0, atol=1e-12)


def test_chunks_do_not_change_the_result():
    source, target, (_, faces) = head(1, 2), head(2, 2), ball(2)
    transfer = DeformationTransfer(source, target, faces, cranium(2))
    frames = expressions(1, 2 * CHUNK + 3, subdivisions=2)
    one_by_one = np.concatenate([transfer(frame[None]) for frame in frames])
    np.testing.assert_allclose(transfer(frames), one_by_one, atol=1e-11)
    assert transfer(frames[:0]).shape == (0, *source.shape)


def test_a_triangle_that_collapses_in_an_expression_is_finite():
    source, target, (_, faces) = head(1, 2), head(2, 2), ball(2)
    frame = source.copy()
    frame[faces[5]] = frame[faces[5, 0]]
    assert np.isfinite(DeformationTransfer(source, target, faces, NO_ANCHORS)(frame[None])).all()


def test_the_two_forms_differ():
    source, target, (_, faces) = head(1), head(2), ball()
    uniform, area = (DeformationTransfer(source, target, faces, cranium(), w)(expressions(1, 1)) for w in Weighting)
    assert 1e-3 < np.abs(uniform - area).max() < 5


def test_refuses_what_it_cannot_use():
    source, target, (_, faces) = head(1, 2), head(2, 2), ball(2)
    with pytest.raises(InvalidInput, match="target_neutral: expected 162 vertices"):
        DeformationTransfer(source, target[:-1], faces, NO_ANCHORS)
    with pytest.raises(InvalidInput, match=r"anchors: expected vertex indices from 0 to 161, got 3 to 162"):
        DeformationTransfer(source, target, faces, np.array([3, 162]))
    flat = target.copy()
    flat[faces[7, 1]] = flat[faces[7, 0]]
    with pytest.raises(InvalidInput, match=r"target_neutral: .* triangles are degenerate"):
        DeformationTransfer(source, flat, faces, NO_ANCHORS)
    with pytest.raises(InvalidInput, match=r"source_frames: .* NaN or infinite"):
        DeformationTransfer(source, target, faces, NO_ANCHORS)(np.full((1, *source.shape), np.nan))
    with pytest.raises(ValueError, match="cotangent"):
        DeformationTransfer(source, target, faces, NO_ANCHORS, "cotangent")


def test_regions_without_a_cranium_are_served():
    source, target, (_, faces) = head(1, 2), head(2, 2), ball(2)
    pair = Pair(faces, source, target, Regions())
    expected = DeformationTransfer(source, target, faces, NO_ANCHORS)(expressions(1, 1, 2))
    np.testing.assert_array_equal(DeformationTransfer.of(pair, "uniform")(expressions(1, 1, 2)), expected)


@weightings
@pytest.mark.parametrize("anchored", [True, False])
def test_the_transfer_of_a_few_vertices(weighting, anchored):
    """Two pieces, of which one may have no anchors; pinned vertices and anchors are among those asked for."""
    source, target, (_, faces) = head(1, 2), 1.3 * head(2, 2), ball(2)
    n = len(source)
    two = np.concatenate([faces, faces + n])
    source, target = np.vstack([source, source + 300]), np.vstack([target, target + 500])
    anchors = np.r_[5:20, n + 7 : n + 30] if anchored else np.arange(5, 20)
    transfer = DeformationTransfer(source, target, two, anchors, weighting)
    asked = np.array([0, 3, 7, 40, n, n + 11, n + 60, 2 * n - 1])
    points = transfer.at(asked)
    for one in expressions(1, 3, subdivisions=2):
        expression = np.vstack([one, 300 + 1.1 * one[::-1]])
        np.testing.assert_allclose(points(expression), transfer(expression[None])[0][asked], atol=1e-9)
    np.testing.assert_allclose(points(source), target[asked], atol=1e-9)
    assert points._anchored == anchored
