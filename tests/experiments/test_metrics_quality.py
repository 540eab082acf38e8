"""Metrics of quality by hand, and on a real head: a worse prediction scores worse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hydra.utils import instantiate

from experiments.catalogue import composed, options
from experiments.metrics.edge_deviation import EdgeDeviation
from experiments.metrics.lid_overclosure import LidOverclosure
from experiments.metrics.lip_depth import LipPenetration
from experiments.metrics.metric import Comparison, Metric
from experiments.metrics.mouth_opening import MouthOpening
from experiments.metrics.normal_deviation import NormalDeviation
from experiments.metrics.relative_error import RelativeError
from experiments.metrics.self_intersections import SelfIntersections
from experiments.metrics.sized_error import SizedError
from experiments.metrics.tissue import Tissue, strain
from experiments.metrics.volume import Volume
from retarget.types import FloatArray, IntArray, Regions
from tests.conformance.box import heads_are_boxes
from tests.experiments.block import block

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], dtype=float)
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
ALL = Regions(vertices={"head": np.arange(4)})


def measured(
    metric: Metric,
    retargeted: FloatArray,
    truth: FloatArray,
    neutral: FloatArray = SQUARE,
    faces: IntArray = HALVES,
    regions: Regions = ALL,
) -> dict[tuple[str, str], list[float]]:
    """Rounded values of each measure for one frame or several."""
    found, true = (np.atleast_3d(frames).reshape(-1, *neutral.shape) for frames in (retargeted, truth))
    values = metric(Comparison(found, true, true, neutral, neutral, faces, regions))
    return {(m.metric, m.region): m.values.round(9).tolist() for m in values}


def moved(vertices: FloatArray, *by: float) -> FloatArray:
    return vertices + np.array(by)


def turned(vertices: FloatArray, degrees: float) -> FloatArray:
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return vertices @ np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]).T


def test_relative_error_by_hand() -> None:
    truth = np.stack([moved(SQUARE, 0, 0, 2), moved(SQUARE, 0, 0, 0.01)])
    values = measured(RelativeError(["head"]), moved(truth, 0.5, 0, 0), truth)
    assert values == {("relative_error", "head"): [25.0, 500.0]}  # the second frame counts as moving by 0.1 mm
    assert measured(RelativeError(["head"]), SQUARE, truth[0])["relative_error", "head"] == [100.0]


def test_sized_error_by_hand() -> None:
    values = measured(SizedError(["head"]), moved(SQUARE, 0.5, 0, 0), SQUARE)
    assert values == {("sized_error", "head"): [25.0]}  # the square's side is 2 mm
    large = measured(SizedError(["head"]), moved(2 * SQUARE, 0.5, 0, 0), 2 * SQUARE, 2 * SQUARE)
    assert large == {("sized_error", "head"): [12.5]}


# Lips as two squares about each other: the contour has a side of 4 mm, the loop between the lips lies inside of it.
CONTOUR = 4 * (SQUARE - [1, 1, 0]) / 2
CLOSED = np.array([[-1, 0, 0], [1, 0, 0], [1, 0.1, 0], [-1, 0.1, 0]], dtype=float)
LIPS = np.concatenate([CONTOUR, CLOSED])


def mouth(height: float) -> FloatArray:
    return np.concatenate([CONTOUR, [[-1, 0, 0], [1, 0, 0], [1, height, 0], [-1, height, 0]]])


@pytest.mark.parametrize("inner", [[4, 5, 6, 7], [7, 6, 5, 4], [6, 7, 4, 5]])
def test_mouth_opening_by_hand(inner: list[int]) -> None:
    regions = Regions(loops={"lip_contour": np.arange(4), "lip_inner": np.array(inner)})
    metric = MouthOpening("lip_inner", "lip_contour")

    def opening(found: float, true: float) -> float:
        values = measured(metric, mouth(found), mouth(true), LIPS, HALVES, regions)
        return values["mouth_opening", "mouth"][0]

    assert opening(1.0, 1.0) == 0
    assert opening(1.5, 1.0) == pytest.approx(1 / 16)
    assert opening(0.5, 1.0) == pytest.approx(1 / 16)
    assert opening(-0.5, 1.0) == pytest.approx(3 / 16)  # lips that passed each other are no open mouth
    tilted = measured(metric, mouth(1.5) + 7.0, mouth(1.0), LIPS, HALVES, regions)
    assert tilted["mouth_opening", "mouth"] == [pytest.approx(1 / 16)]


def test_lid_overclosure_by_hand() -> None:
    x = np.arange(7.0)
    height = np.array([0, 1, 2, 2, 2, 1, 0.0])
    top, bottom = (np.stack([x, sign * height, 0.2 * height], axis=1) for sign in (1, -1))
    open_eye = np.concatenate([top, bottom[5:0:-1]])  # a loop from the inner corner over the upper lid
    both = np.concatenate([open_eye, moved(open_eye, 20, 0, 0)])
    marks = {"endocanthion_left": 0, "exocanthion_left": 6, "endocanthion_right": 12, "exocanthion_right": 18}
    loops = {"lid_margin_left": np.roll(np.arange(12), 4), "lid_margin_right": np.arange(12, 24)[::-1]}
    regions = Regions(loops=loops, landmarks=marks)
    deep = both.copy()
    deep[1:6, 1] = both[[11, 10, 9, 8, 7], 1] - [0, 0.3, 0.5, 0.3, 0]  # the left upper lid, below the lower one
    values = measured(LidOverclosure(["left", "right"]), np.stack([both, deep, deep + 3]), np.stack([both] * 3), both,
                      HALVES, regions)  # fmt: skip
    assert values["lid_overclosure", "eye_left"] == [0, 0.5, 0.5]
    assert values["lid_overclosure", "eye_right"] == [0, 0, 0]
    assert values["lid_overclosure", "eyes"] == [0, 0.5, 0.5]


def test_normal_deviation_by_hand() -> None:
    truth = moved(turned(SQUARE, 20), 1, 2, 3)
    found = np.stack([turned(SQUARE, 50), turned(SQUARE, 200), 0 * SQUARE, truth])
    values = measured(NormalDeviation(["head"]), found, np.stack([truth] * 4))["normal_deviation", "head"]
    assert values == pytest.approx([30, 180, 90, 0], abs=1e-6)


def test_edge_deviation_by_hand() -> None:
    values = measured(EdgeDeviation(["head"]), np.stack([1.2 * SQUARE, turned(SQUARE, 30) + 5]), np.stack([SQUARE] * 2))
    assert values["edge_deviation", "head"] == pytest.approx([20, 0], abs=1e-6)
    stretched = measured(EdgeDeviation(["head"]), SQUARE * [1.5, 1, 1], SQUARE)["edge_deviation", "head"][0]
    assert stretched == pytest.approx(100 * (2 * 0.5 + (np.sqrt(13) - np.sqrt(8)) / np.sqrt(8)) / 5)


def test_volume_by_hand() -> None:
    cube = trimesh.creation.box((10, 10, 10))
    corners, faces = np.asarray(cube.vertices), np.asarray(cube.faces, dtype=np.int64)
    height = cube.face_normals[:, 2]
    for kept in (faces, faces[height < 0.5], faces[np.abs(height) < 0.5]):  # closed, a lid off, a tube
        found = np.stack([1.1 * corners, turned(corners, 33) + 70])
        values = measured(Volume(), found, np.stack([corners] * 2), corners, kept, Regions())
        assert values["volume_change", "all"] == pytest.approx([0.331, 0])
        assert values["volume_error", "all"] == pytest.approx([0.331, 0])
    smaller = measured(Volume(), 0.9 * corners, corners, corners, faces, Regions())
    assert smaller == {("volume_error", "all"): [0.271], ("volume_change", "all"): [-0.271]}


def test_crossings_by_hand() -> None:
    """Three triangles one above the other; those that cross at rest do not count."""
    triangle = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]], dtype=float)
    upright = np.array([[1, 1, -1], [1, 1, 1], [1.5, 1, 1]], dtype=float)
    faces, regions = np.arange(9).reshape(3, 3), Regions(vertices={"head": np.arange(3)})
    neutral = np.concatenate([triangle, upright, moved(upright, 0, 0, 9)])
    dipped = np.concatenate([triangle, upright, moved(upright, 0.2, -0.5, 0)])
    apart = np.concatenate([triangle - [0, 0, 5], upright, moved(upright, 0, 0, 9)])
    hidden = np.concatenate([triangle - [0, 0, 5], upright, upright * [1, 1, 0] + [-0.1, -0.1, 0.5]])
    values = measured(SelfIntersections("head"), np.stack([neutral, dipped, apart, hidden]), np.stack([neutral] * 4),
                      neutral, faces, regions)  # fmt: skip
    assert values["self_intersections", "head"] == [0, 1, 0, 0]


def test_lip_depth_is_how_far_a_lip_was_pushed_into_the_other() -> None:
    data = block()
    neutral, regions = data.neutral("a"), data.regions
    lower = np.setdiff1d(regions.vertices["lower_lip"], regions.vertices["upper_lip"])
    frames = np.stack([neutral] * 3)
    frames[1, lower, 1] += 1.6  # the gap is 1 mm
    frames[2, lower, 1] += 2.0
    depths = measured(LipPenetration(), frames, frames, neutral, data.faces, regions)["lip_depth", "lips"]
    assert depths == pytest.approx([0, 0.6, 1.0], abs=1e-6)


def test_tissue_is_whole_at_rest_and_suffers_from_what_no_head_can_do() -> None:
    data = block()
    neutral = data.neutral("a")
    bulge = np.exp(-((neutral - [15.0, 40, 20]) ** 2).sum(-1) / (2 * 6.0**2))[:, None] * [0, 0, 1.0]
    frames = np.stack([neutral, neutral + 2 * bulge, neutral - 20 * bulge])
    with heads_are_boxes():
        values = measured(Tissue(), frames, frames, neutral, data.faces, data.regions)
    rest, little, much = values["tissue_volume_change", "tissue"]
    assert rest == pytest.approx(0, abs=1e-6)
    assert 0 < little < much
    assert values["inverted_tets", "tissue"][0] == 0
    assert values["inverted_tets", "tissue"][2] > 0


def test_tissue_weighs_changes_by_volume_and_counts_inverted_tets() -> None:
    gradients = np.stack([np.eye(3), np.diag([2.0, 1, 1]), np.diag([0.5, 1, 1]), np.diag([-1.0, 1, 1])])
    change, inverted = strain(gradients, np.array([5.0, 1.0, 3.0, 1.0]))
    assert change == pytest.approx(100 * (0 * 5 + 1 * 1 + 0.5 * 3 + 2 * 1) / 10)
    assert inverted == pytest.approx(25)


# A real head: every metric must see an error that grows.


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    """Two people of the embedded dataset; the prediction is the truth."""
    config = composed("run", ["dataset.truth=personal_blendshapes", "dataset.identities=2", "dataset.subdivisions=0"])
    data = instantiate(config.dataset).load()
    source, target = data.identities
    chosen = [0, 7]
    truth = data.frames(target, chosen)
    return Comparison(
        truth, truth, data.frames(source, chosen), data.neutral(source), data.neutral(target), data.faces, data.regions
    )


PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"


def page_rows() -> dict[str, str]:
    """The rows of the page's table by metric."""
    table = PAGE.read_text(encoding="utf-8").split("\n\n")
    lines = next(part for part in table if part.startswith("| metric |")).splitlines()[2:]
    return {line.split("`")[1]: line for line in lines}


def test_the_page_lists_every_metric() -> None:
    assert set(page_rows()) == set(options("metric"))


NEED_MORE = ("acceleration", "noise_response", "tissue")  # than single frames, or a template


@pytest.mark.parametrize("name", [name for name in options("metric") if name not in NEED_MORE])
def test_a_worse_prediction_scores_worse(name: str, comparison: Comparison) -> None:
    metric = instantiate(composed(f"metric/{name}").metric[name])
    assert metric.unsupported(comparison.regions) is None
    rng = np.random.default_rng(3)
    error = rng.normal(size=comparison.truth.shape[1:]) * [0.1, 0.5, 0.5] + [0.2, 0.2, -0.2]
    error[comparison.regions.vertices["upper_lip"], 1] -= 2.0  # lips and lids shut, and the face grows
    for side in ("left", "right"):
        error[comparison.regions.vertices[f"lid_margin_upper_{side}"], 1] -= 8.0
    error += 0.01 * (comparison.target_neutral - comparison.target_neutral.mean(axis=0))
    scores: dict[tuple[str, str, str], list[float]] = {}
    row = page_rows()[name]
    for amount in (0.0, 1.0, 1.8):
        worse_off = replace(comparison, retargeted=comparison.truth + amount * error)
        for m in metric(worse_off):
            assert f"`{m.metric}`" in row or f"`_{m.metric.rsplit('_', 1)[1]}`" in row
            assert m.unit in row.split("|")[3]
            assert m.direction in row.split("|")[4]
            scores.setdefault((m.metric, m.region, m.direction), []).append(float(np.mean(m.values)))
    assert scores
    for (measure, region, direction), (perfect, bad, worse) in scores.items():
        assert np.isfinite([perfect, bad, worse]).all()
        if direction == "lower":
            assert perfect < bad < worse, (measure, region)
        if direction == "zero" and measure != "volume_change":
            assert abs(perfect) < abs(bad) < abs(worse), (measure, region)
