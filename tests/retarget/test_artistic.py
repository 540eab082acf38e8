"""Artistic edits on a block with a mouth: what they refuse, what they leave alone, where and how far they move."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from experiments.catalogue import make_method
from retarget.artistic import Edits, patches_of
from retarget.check import InvalidInput
from retarget.direction import faded_strengths
from retarget.geometry.patches import contiguous_patches
from retarget.simulation.materials import EARTH
from retarget.types import Fitted, FloatArray, Regions, RetargetProblem
from tests.conformance.box import box_problem, heads_are_boxes

EXPRESSIONS = slice(6, 8)  # beyond the examples
SAME = 1e-6  # mm: an edit that changes nothing leaves the result within it
PATCHES = tuple(np.arange(10 * i, 10 * i + 10) for i in range(4))
REGIONS = Regions(
    vertices={"head": np.arange(35), "lips": np.arange(4, 21), "dot": np.array([32])},
    loops={"lip_contour": np.arange(4, 12)},
    landmarks={"cheilion_left": 5, "hidden": 39},
)


@pytest.fixture(scope="module")
def problem() -> Iterator[RetargetProblem]:
    with heads_are_boxes():
        yield box_problem()


@pytest.fixture(scope="module")
def frames(problem: RetargetProblem) -> FloatArray:
    return problem.source_animation[EXPRESSIONS]


@pytest.fixture(scope="module", params=["anacondar", "anacondar_paper", "plbs_anacon"])
def fitted(request: pytest.FixtureRequest, problem: RetargetProblem) -> Fitted:
    method = make_method(request.param, patch_count=12)
    return method.prepare(problem.pair).fit(problem.examples, problem.source_animation)


@pytest.fixture(scope="module")
def plain(fitted: Fitted, frames: FloatArray) -> FloatArray:
    return fitted(frames).frames


def contour_edit(problem: RetargetProblem, factor: float = 1.0) -> dict[int, FloatArray]:
    """The contour's left end goes up and out, three more points stay."""
    contour = problem.regions.loops["lip_contour"]
    x, y = problem.target_neutral[contour, :2].T
    ends = [int(contour[i]) for i in (np.argmax(x + 1e-3 * y), np.argmin(x + 1e-3 * y))]
    middle = [int(v) for v in contour[np.argsort(np.abs(x))[:2]]]
    return {ends[0]: np.array([1.0, 2.0, 0.5]) * factor} | {v: np.zeros(3) for v in (ends[1], *middle)}


@pytest.mark.parametrize(
    "nothing",
    [
        {},
        {"gravity": EARTH},
        {"stiffness": {"upper_lip": 1.0}},
        {"patch_weights": {0: 1.0, "jaw_skin": 1}},
        {"control_points": {}},
        {"control_points": "contour"},
    ],
    ids=lambda edits: "-".join(edits) or "none",
)
def test_an_edit_that_changes_nothing_returns_the_unedited_result(
    fitted: Fitted, frames: FloatArray, plain: FloatArray, problem: RetargetProblem, nothing: dict[str, Any]
) -> None:
    edits = {"control_points": contour_edit(problem, 0.0)} if "contour" in nothing.values() else nothing
    np.testing.assert_allclose(fitted(frames, edits).frames, plain, atol=SAME)


def test_the_contour_follows_its_control_points_and_the_cranium_stays(
    fitted: Fitted, frames: FloatArray, plain: FloatArray, problem: RetargetProblem
) -> None:
    edit = contour_edit(problem)
    moved = fitted(frames, {"control_points": edit}).frames - plain
    for vertex, displacement in edit.items():
        np.testing.assert_allclose(moved[:, vertex], np.tile(displacement, (len(frames), 1)), atol=0.1)
    contour = problem.regions.loops["lip_contour"]
    others = np.setdiff1d(contour, list(edit))
    assert np.linalg.norm(moved[:, others], axis=2).max() > 0.2  # the rest of the contour comes along
    far = np.linalg.norm(moved[:, problem.regions.vertices["cranium"]], axis=2)  # some 20 mm away
    assert far.max() < 0.15 * np.linalg.norm(moved, axis=2).max()


def test_twice_the_displacement_moves_the_tissue_twice_as_far(
    fitted: Fitted, frames: FloatArray, plain: FloatArray, problem: RetargetProblem
) -> None:
    half, whole = (fitted(frames, {"control_points": contour_edit(problem, s)}).frames - plain for s in (0.25, 0.5))
    near = np.linalg.norm(whole, axis=2) > 0.05
    assert near.any()
    assert (np.linalg.norm(whole, axis=2)[near] > 1.5 * np.linalg.norm(half, axis=2)[near]).all()


def test_positions_are_displacements_from_the_result(
    fitted: Fitted, frames: FloatArray, plain: FloatArray, problem: RetargetProblem
) -> None:
    one = frames[:1]
    moves = contour_edit(problem)
    places = {vertex: plain[0, vertex] + move for vertex, move in moves.items()}
    by_moves, by_places = fitted(one, {"control_points": moves}), fitted(one, {"control_positions": places})
    np.testing.assert_allclose(by_places.frames, by_moves.frames, atol=1e-9)


def test_a_control_point_off_the_contour_moves_alone(
    fitted: Fitted, frames: FloatArray, plain: FloatArray, problem: RetargetProblem
) -> None:
    front = np.flatnonzero(problem.target_neutral[:, 2] > 0.99 * problem.target_neutral[:, 2].max())
    vertex = int(front[np.argmax(problem.target_neutral[front, 0] + problem.target_neutral[front, 1])])
    moved = fitted(frames, {"control_points": {vertex: (0, 0, 1.0)}}).frames - plain
    np.testing.assert_allclose(moved[:, vertex, 2], 1.0, atol=0.1)
    contour = np.linalg.norm(moved[:, problem.regions.loops["lip_contour"]], axis=2)
    assert contour.max() < 0.3


def test_tissue_under_another_gravity_moves_its_way(
    fitted: Fitted, frames: FloatArray, plain: FloatArray, problem: RetargetProblem
) -> None:
    for axis, sign in ((0, 1.0), (1, 1.0), (2, -1.0)):
        pull = np.array(EARTH)
        pull[axis] += sign * 9.81
        moved = (fitted(frames, {"gravity": pull}).frames - plain).mean(axis=(0, 1))
        assert moved[axis] * sign > 0
        assert np.argmax(np.abs(moved)) == axis


def test_strengths_scale_the_motion_of_their_patches(
    fitted: Fitted, frames: FloatArray, plain: FloatArray, problem: RetargetProblem
) -> None:
    moved = {
        s: fitted(frames, {"patch_weights": dict.fromkeys(range(12), s)}).frames - problem.target_neutral
        for s in (0.0, 1.0, 1.5, 2.0)
    }
    assert np.abs(moved[0.0]).max() < 3e-5  # the neutral
    size = {s: np.linalg.norm(m, axis=2).mean() for s, m in moved.items()}
    assert size[0.0] < size[1.0] < size[1.5] < size[2.0]
    assert size[2.0] == pytest.approx(2 * size[1.0], rel=0.15)


def test_the_strength_of_one_patch_acts_there(
    fitted: Fitted, frames: FloatArray, plain: FloatArray, problem: RetargetProblem
) -> None:
    patches = contiguous_patches(problem.faces, len(problem.target_neutral), 12, 0)
    motion = np.linalg.norm(plain - problem.target_neutral, axis=2).mean(axis=0)
    busiest = int(np.argmax([motion[patch].mean() for patch in patches]))
    once, twice = (
        np.linalg.norm(fitted(frames, {"patch_weights": {busiest: s}}).frames - plain, axis=2).mean(axis=0)
        for s in (1.5, 2.0)
    )
    assert twice[patches[busiest]].mean() > 1.5 * once[patches[busiest]].mean() > 0
    assert twice[patches[busiest]].mean() > 3 * np.delete(twice, patches[busiest]).mean()


def test_stiffer_tissue_follows_its_draft_less(problem: RetargetProblem, frames: FloatArray) -> None:
    """By `plbs_anacon`, whose result is what the tissue of the inverse simulation does."""
    fitted = make_method("plbs_anacon", patch_count=12).prepare(problem.pair)
    method = fitted.fit(problem.examples, problem.source_animation)
    region = problem.regions.vertices["cranium_skin"]
    miss = []
    for factor in (1.0, 10.0, 100.0):
        result = method(frames, {"stiffness": {"cranium_skin": factor}})
        miss.append(np.linalg.norm((result.frames - result.parts["draft"])[:, region], axis=2).mean())
    assert miss == sorted(miss)
    assert miss[-1] > 1.5 * miss[0]


def test_faded_strengths_stay_between_those_of_the_patches(problem: RetargetProblem) -> None:
    patches = contiguous_patches(problem.faces, len(problem.target_neutral), 12, 0)
    given = np.ones(12)
    given[3] = 2.0
    faded = faded_strengths(problem.pair, patches, given)
    assert faded.min() >= 1 - 1e-12
    assert faded.max() <= 2 + 1e-12
    assert faded[patches[3]].mean() > 1.4
    assert (faded_strengths(problem.pair, patches, np.full(12, 1.5)) == 1.5).all()


def test_a_region_means_the_patches_that_lie_in_it_and_at_least_one() -> None:
    assert patches_of(REGIONS.vertices["lips"], PATCHES) == [0, 1]  # 6 and 10 of 10 vertices; 1 of the third
    assert patches_of(REGIONS.vertices["dot"], PATCHES) == [3]


def test_edits_are_read_by_names_and_numbers() -> None:
    edits = Edits.of(
        {
            "control_points": {"cheilion_left": (0, 1, 0)},
            "control_positions": {7: [1, 2, 3]},
            "stiffness": {"lips": 2, "head": 1.0},
            "gravity": [0, 0, -9.81],
            "patch_weights": {"lips": 2, 1: 0.5},
        },
        REGIONS,
        PATCHES,
    )
    assert edits.control.vertices.tolist() == [5, 7]
    skin = np.full((40, 3), 0.5)
    np.testing.assert_allclose(edits.control.displacements(skin), np.array([[0, 1, 0], [0.5, 1.5, 2.5]]))
    assert edits.stiffness == (("lips", 2.0),)
    np.testing.assert_allclose(edits.strengths, np.array([2, 1, 1, 1]))


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        ({"patch_weigths": {}}, "'patch_weigths' is unknown.*Did you mean 'patch_weights'"),
        ("gravity", "edits: expected a mapping"),
        ({"stiffness": 2.0}, "stiffness: expected a mapping, got 2.0"),
        ({"stiffness": {"lisp": 2.0}}, "'lisp' is unknown.*Did you mean 'lips'"),
        ({"stiffness": {"lips": 0}}, r"stiffness\['lips'\]: expected a finite factor > 0, got 0"),
        ({"stiffness": {"lips": "firm"}}, "expected numbers, got 'firm'"),
        ({"stiffness": {"lips": [1, 2]}}, "expected one number"),
        ({"patch_weights": {"lips": -1}}, "factor >= 0, got -1"),
        ({"patch_weights": {"lisp": 1}}, "Did you mean 'lips'"),
        ({"patch_weights": {4: 2}}, "numbers of patches from 0 to 3, got 4"),
        ({"patch_weights": {True: 2}}, "numbers of patches"),
        ({"gravity": (0, -9.81)}, "gravity: expected a vector"),
        ({"gravity": (0, np.nan, 0)}, "gravity: expected a vector"),
        ({"gravity": "down"}, "gravity: expected numbers"),
        ({"control_points": {"cheilion_lefd": (0, 0, 1)}}, "Did you mean 'cheilion_left'"),
        ({"control_points": {"hidden": (0, 0, 1)}}, "vertex 39 is not on the head"),
        ({"control_points": {38: (0, 0, 1)}}, "vertex 38 is not on the head"),
        ({"control_points": {40: (0, 0, 1)}}, "vertex 40 is none of the skin's, which are 0 to 39"),
        ({"control_points": {1.5: (0, 0, 1)}}, "expected vertex indices or names of landmarks, got 1.5"),
        ({"control_points": {5: (0, 1)}}, r"control_points\[5\]: expected shape \(3,\)"),
        ({"control_points": {5: (0, 1, np.inf)}}, "expected finite numbers in mm"),
        ({"control_points": [(0, 0, 1)]}, "control_points: expected a mapping"),
        ({"control_points": {5: (0, 1, 0)}, "control_positions": {5: (0, 1, 0)}}, "vertex 5 has a displacement"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(edits: Any, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        Edits.of(edits, REGIONS, PATCHES)
