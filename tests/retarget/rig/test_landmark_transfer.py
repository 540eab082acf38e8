"""Landmark-guided deformation transfer: what is exact, where landmarks go, a literal second implementation, lids."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput, UnsupportedProblem
from retarget.geometry.triangles import deformation_gradients
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.rig.landmark_transfer import (
    LANDMARKS,
    PARTS,
    LandmarkTransfer,
    LandmarkWeights,
    Regularity,
    extent,
    lacking,
    part_frame,
    part_maps,
)
from retarget.types import FloatArray, Pair, Regions
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.dataset import MakeHuman
from tests.synthetic import ball, cranium, expressions, head, landmarks, problem, regions

FACES = ball()[1]
PLACES = np.array([landmarks()[name] for name in LANDMARKS])


def pair(source: FloatArray, target: FloatArray) -> Pair:
    return Pair(FACES, source, target, regions())


@pytest.mark.parametrize("scale", [1.0, 0.25, 3.0])
def test_self_and_scaled_copy_are_exact(scale):
    source = head(1)
    transfer = LandmarkTransfer(pair(source, scale * source - 5), LandmarkWeights())
    frames = expressions(1, 4)
    np.testing.assert_allclose(transfer(frames), scale * frames - 5, atol=1e-9)


def test_a_turned_copy_puts_the_landmarks_where_they_belong_as_far_as_it_yaws_and_pitches():
    source = head(1)
    turn = Rotation.from_euler("y", 25, degrees=True).as_matrix()
    maps = part_maps(source[PLACES], source[PLACES] @ turn.T, 1.0)
    np.testing.assert_allclose(maps, np.broadcast_to(turn, (51, 3, 3)), atol=1e-9)


def test_neutral_stays_neutral():
    for regularity in Regularity:
        transfer = LandmarkTransfer(pair(head(1), head(2)), LandmarkWeights(regularity=regularity))
        np.testing.assert_allclose(transfer(head(1)[None])[0], head(2), atol=1e-9)


def test_landmarks_go_where_they_are_wanted_and_the_cranium_stays():
    transfer = LandmarkTransfer(pair(head(1), head(2)), LandmarkWeights(w_landmarks=1e6))
    frames = expressions(1, 3)
    moved = transfer(frames) - head(2)
    single = np.array([list(PLACES).count(vertex) == 1 for vertex in PLACES])  # parts of the ball share some
    wanted = transfer.wanted(frames)
    assert np.linalg.norm(wanted, axis=-1).max() > 1
    np.testing.assert_allclose(moved[:, PLACES[single]], wanted[:, single], atol=1e-2)
    assert np.abs(moved[:, cranium()]).max() < 1e-2


def test_without_landmarks_it_comes_close_to_deformation_transfer():
    """As their weight vanishes only the smoothness of what is added to the source's gradients is left."""
    source, target, frames = head(1), head(2), expressions(1, 3)
    free = LandmarkWeights(w_landmarks=1e-9, w_smooth=0, w_back=1e-9)
    plain = DeformationTransfer.of(pair(source, target), Weighting.UNIFORM)(frames)
    transfer = LandmarkTransfer(pair(source, target), free)(frames)
    shift = (plain - transfer).mean(axis=1, keepdims=True)
    np.testing.assert_allclose(transfer + shift, plain, atol=1e-4)


@pytest.mark.parametrize("regularity", list(Regularity))
def test_minimises_the_energy_as_written(regularity):
    """Against a dense least-squares problem with a row for each term, loops over triangles and their neighbours."""
    points, faces = ball(1)
    marks = regions(1)
    source, target = head(1, 1), head(2, 1)
    weights = LandmarkWeights(w_landmarks=7, w_smooth=0.4, w_identity=0.6, w_back=3, regularity=regularity)
    marks = replace(marks, vertices={"cranium": np.array([3, 11])}, landmarks=spread(len(points)))
    transfer = LandmarkTransfer(Pair(faces, source, target, marks), weights)
    frame = expressions(1, 1, 1)
    n, f = len(points), len(faces)

    wanted = deformation_gradients(source, frame[0], faces)
    gradient = np.zeros((f, 3, n + f))  # T_j^T as rows over vertices and fourth vertices, less v1
    for j, (a, b, c) in enumerate(faces):
        e1, e2 = target[b] - target[a], target[c] - target[a]
        normal = np.cross(e1, e2)
        inverse = np.linalg.inv(np.stack([e1, e2, normal / np.sqrt(np.linalg.norm(normal))], axis=1))
        for row, ends in zip(inverse, ((b, a), (c, a), (n + j, None)), strict=True):
            gradient[j, :, ends[0]] += row
            if ends[1] is not None:
                gradient[j, :, ends[1]] -= row
    rows, right = [], []
    for j in range(f):
        rows.append(gradient[j])
        right.append(wanted[j].T)
        for k in range(f):
            if k != j and len(set(faces[j]) & set(faces[k])) == 2:
                rows.append(np.sqrt(0.4) * (gradient[j] - gradient[k]))
                kept = (wanted[j] - wanted[k]).T if regularity is Regularity.CORRECTION else np.zeros((3, 3))
                right.append(np.sqrt(0.4) * kept)
        if regularity is Regularity.DEFORMATION:
            rows.append(np.sqrt(0.6) * gradient[j])
            right.append(np.sqrt(0.6) * np.eye(3))
    held = [(v, 3, transfer.size_ratio * (frame[0] - source)[v]) for v in (3, 11)]
    numbers = [marks.landmarks[name] for name in LANDMARKS]
    held += [(v, 7, moved) for v, moved in zip(numbers, transfer.wanted(frame)[0], strict=True)]
    for vertex, weight, moved in held:
        rows.append(np.sqrt(weight) * np.eye(n + f)[[vertex]])
        right.append(np.sqrt(weight) * (target[vertex] + moved)[None])
    matrix, wants = np.concatenate(rows), np.concatenate(right)
    solution, *_ = np.linalg.lstsq(matrix, wants, rcond=None)
    np.testing.assert_allclose(transfer(frame)[0], solution[:n], atol=1e-8)


def spread(count: int) -> dict[str, int]:
    """51 landmarks on any vertices, some of them twice."""
    return {name: int(v) for name, v in zip(LANDMARKS, np.random.default_rng(0).integers(0, count, 51), strict=True)}


def test_a_part_is_measured_in_a_frame_that_yaws_and_pitches():
    flat = np.random.default_rng(1).uniform(-1, 1, (8, 2)) @ [[20.0, 0, 0], [0, 10, 0]]
    turn = Rotation.from_euler("YX", [20, -15], degrees=True).as_matrix()
    axes = part_frame(flat @ turn.T + [1, 2, 3])
    np.testing.assert_allclose(axes, turn, atol=1e-9)
    brow = PARTS[0]
    points = np.zeros((51, 3))
    points[list(brow.members)] = flat[:5] @ turn.T
    np.testing.assert_allclose(extent(points, brow, axes), [*np.ptp(flat[:5, :2], axis=0), 0], atol=1e-9)


def test_the_mouths_height_is_that_of_the_upper_lip_and_its_depth_follows_the_heads_size():
    source = head(1)[PLACES]
    target = source.copy()
    target[[15, 16, 17]] += [0, 5, 0]
    mouth = list(PARTS[5].members)
    height = [np.linalg.norm(p[[15, 16, 17]] - p[[44, 45, 46]], axis=1).mean() for p in (source, target)]
    axes = part_frame(source[list(PARTS[5].plane)])
    expected = axes @ np.diag([1, height[1] / height[0], 1.7]) @ axes.T
    np.testing.assert_allclose(part_maps(source, target, 1.7)[mouth[0]], expected, atol=1e-9)


def test_lids_close_better_than_by_deformation_transfer():
    """On average over 6 pairs: what stays open of the eyes."""
    data = MakeHuman(
        identities=3, first_seed=0, subdivisions=0, expressions=1, truth="personal_blendshapes", weights="sparse"
    ).load()
    blink = np.zeros((1, len(SKIN_NAMES)))
    blink[0, [SKIN_NAMES.index("eyeBlinkLeft"), SKIN_NAMES.index("eyeBlinkRight")]] = 1
    blinking = {name: data.performers[name](blink) for name in data.identities}
    half = len(data.regions.loops["lid_margin_left"]) // 2
    margins = [data.regions.loops[f"lid_margin_{side}"] for side in ("left", "right")]
    upper = np.concatenate([margin[1:half] for margin in margins])
    lower = np.concatenate([margin[:half:-1] for margin in margins])

    def gap(v: FloatArray) -> FloatArray:
        return v[..., upper, 1] - v[..., lower, 1]

    stays_open = []
    for source, target in permutations(data.identities, 2):
        both = Pair(data.faces, data.neutral(source), data.neutral(target), data.regions)
        plain = DeformationTransfer.of(both, Weighting.UNIFORM)(blinking[source])
        guided = LandmarkTransfer(both, LandmarkWeights())(blinking[source])
        gaps = gap(np.concatenate([plain, guided, blinking[target]])).clip(0)
        stays_open.append(gaps.sum(axis=1) / gap(both.target_neutral).sum())
    plain, guided, truth = np.mean(stays_open, axis=0)
    assert truth < guided < 0.97 * plain


def test_missing_landmarks_and_loose_pieces_are_a_reason():
    from baselines.landmark_dt import LandmarkDeformationTransfer

    given = problem()
    marks = {name: vertex for name, vertex in landmarks().items() if name not in ("ibug_07", "ibug_30")}
    bare = replace(given, regions=Regions(given.regions.vertices, landmarks=marks))
    method = LandmarkDeformationTransfer()
    assert method.unsupported(given) is None
    with pytest.raises(UnsupportedProblem, match=r"2 of the 51 landmarks ibug_00 to ibug_50 are unknown, .* ibug_07"):
        method.retarget(bare, given.source_animation)
    with pytest.raises(InvalidInput, match="ibug_07"):
        LandmarkTransfer(bare.pair, LandmarkWeights())
    two = np.concatenate([FACES, FACES + len(given.source_neutral)])
    assert "1 connected pieces of the mesh hold neither" in str(lacking(two, 2 * len(given.source_neutral), regions()))


def test_a_part_without_extent_is_refused():
    source = head(1)[PLACES]
    folded = source.copy()
    folded[list(PARTS[3].members)] = source[19]
    with pytest.raises(InvalidInput, match="landmarks: those of the right eye have no extent"):
        part_maps(source, folded, 1.0)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"w_landmarks": 0}, "w_landmarks: expected a positive number"),
        ({"w_smooth": -1}, "w_smooth: expected a number of at least 0"),
        ({"regularity": "correctoin"}, "Did you mean 'correction'"),
    ],
)
def test_weights_out_of_range_are_refused(wrong, words):
    with pytest.raises(InvalidInput, match=words):
        LandmarkWeights(**wrong)
