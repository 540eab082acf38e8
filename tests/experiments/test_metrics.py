import numpy as np
import pytest

from experiments.metrics.eye_aperture import EyeAperture
from experiments.metrics.lip_error import LipError
from experiments.metrics.metric import Comparison, Metric
from experiments.metrics.seam_jump import SeamJump, patch_edges
from experiments.metrics.signed_error import SignedError
from experiments.metrics.vertex_l2 import VertexL2
from retarget.check import InvalidInput
from retarget.geometry.patches import contiguous_patches
from retarget.types import FloatArray, Regions
from tests.synthetic import ball, head

REGIONS = Regions(vertices={"head": np.arange(4), "lips": np.array([0, 1])})


def comparison(error: FloatArray) -> Comparison:
    truth = np.random.default_rng(0).normal(size=error.shape)
    blank = np.zeros(error.shape[1:])
    return Comparison(truth + error, truth, truth, blank, blank, np.array([[0, 1, 2]]), REGIONS)


def measured(metric: Metric, error: FloatArray) -> dict[tuple[str, str], list[float]]:
    return {(m.metric, m.region): m.values.round(12).tolist() for m in metric(comparison(error))}


def test_vertex_l2_by_hand() -> None:
    error = np.array(
        [[[3, 4, 0], [0, 0, 1], [0, 0, 0], [0, 2, 0]], [[0, 0, 0], [0, 0, 0], [0, 0, 0], [1, 2, 2]]], float
    )
    values = measured(VertexL2(["mean", "max", "p95"], ["head", "lips"]), error)
    assert values["vertex_l2_mean", "head"] == [2.0, 0.75]
    assert values["vertex_l2_max", "head"] == [5.0, 3.0]
    assert values["vertex_l2_mean", "lips"] == [3.0, 0.0]
    assert values["vertex_l2_p95", "head"] == [4.55, 2.55]  # linear interpolation between the two largest


def test_a_worse_prediction_scores_worse() -> None:
    error = np.random.default_rng(1).normal(size=(3, 4, 3))
    metric = VertexL2(["mean", "p95", "max"], ["head"])
    small, large = measured(metric, error), measured(metric, 1.5 * error)
    assert all(np.all(np.array(large[key]) > np.array(small[key])) for key in small)


def test_signed_error_sees_a_constant_offset_fully() -> None:
    noise = np.array([1.0, -1, 1, -1])[:, None] * np.ones((1, 4, 3))
    values = measured(SignedError(["head"]), noise + np.array([0.05, 0, -0.02]))
    assert values == {
        ("signed_error_x", "head"): [0.05],
        ("signed_error_y", "head"): [0.0],
        ("signed_error_z", "head"): [-0.02],
    }


def test_unknown_statistics_and_regions_are_refused() -> None:
    with pytest.raises(InvalidInput, match="'median'"):
        VertexL2(["median"], ["head"])
    with pytest.raises(InvalidInput, match="'chin': this dataset has head, lips"):
        measured(VertexL2(["mean"], ["chin"]), np.zeros((1, 4, 3)))


# A flat unit square of two triangles, twice: the openings of two eyes.
SQUARES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] * 2, dtype=float)
OPENINGS = {name: np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i, name in enumerate(("left", "right"))}


def eyes(retargeted: FloatArray, truth: FloatArray) -> dict[str, list[float]]:
    faces = np.concatenate(list(OPENINGS.values()))
    given = Comparison(retargeted, truth, truth, SQUARES, SQUARES, faces, Regions(patches=OPENINGS))
    return {m.region: m.values.round(12).tolist() for m in EyeAperture(["left", "right"])(given)}


def test_eye_aperture_by_hand() -> None:
    half, shut = SQUARES * [1, 0.5, 1], SQUARES * [1, 0, 1]
    left_shut = np.concatenate([shut[:4], SQUARES[4:]])
    assert eyes(half[None], SQUARES[None]) == {"left": [0.5], "right": [0.5], "eyes": [0.5]}
    assert eyes(np.stack([left_shut, half]), np.stack([half, half])) == {
        "left": [0.5, 0.0],
        "right": [0.5, 0.0],
        "eyes": [0.5, 0.0],
    }
    wider = eyes(SQUARES[None] * [1, 1.5, 1], SQUARES[None])["eyes"]
    assert wider == eyes(half[None], SQUARES[None])["eyes"]  # too open is as bad as too closed
    assert eyes(shut[None], SQUARES[None])["eyes"] > wider
    assert eyes(SQUARES[None] + 3.0, SQUARES[None])["eyes"] == [0.0]


def test_lip_error_by_hand() -> None:
    error = np.array(
        [[[3, 4, 0], [0, 0, 1], [9, 9, 9], [0, 2, 0]], [[0, 0, 0], [0, 0, 7], [9, 9, 9], [0, 0, 0]]], float
    )
    regions = Regions(vertices={"lips": np.array([0, 1])}, loops={"lip_contour": np.array([0, 1, 3])})
    truth = np.random.default_rng(0).normal(size=error.shape)
    blank = np.zeros((4, 3))
    values = {
        scale: {
            (m.metric, m.region): m.values
            for m in LipError("lips", "lip_contour")(
                Comparison(truth + scale * error, truth, truth, blank, blank, np.array([[0, 1, 2]]), regions)
            )
        }
        for scale in (1.0, 1.5)
    }
    np.testing.assert_allclose(values[1.0]["lip_error_max", "lips"], [5, 7])
    np.testing.assert_allclose(values[1.0]["lip_error_mean", "lip_contour"], [8 / 3, 7 / 3])
    assert all(np.all(values[1.5][key] > values[1.0][key]) for key in values[1.0])


def test_edges_across_and_beside_a_border_by_hand() -> None:
    strip = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4], [4, 5, 6], [5, 7, 6]])  # two by two: 01 23 45 67
    borders, beside = patch_edges(strip, np.arange(8), (np.arange(4), np.arange(4, 8)))
    assert borders.tolist() == [[2, 4], [3, 4], [3, 5]]
    assert beside.tolist() == [[0, 2], [1, 2], [1, 3], [2, 3], [4, 5], [4, 6], [5, 6], [5, 7]]
    borders, beside = patch_edges(strip, np.array([0, 2, 4, 6]), (np.arange(4), np.arange(4, 8)))
    assert (borders.tolist(), beside.tolist()) == ([[2, 4]], [[0, 2], [4, 6]])


def seams(error: FloatArray, neutral: FloatArray, faces: FloatArray) -> dict[tuple[str, str], float]:
    truth = neutral[None]
    regions = Regions(vertices={"head": np.arange(len(neutral))})
    given = Comparison(truth + error, truth, truth, neutral, neutral, faces, regions)
    return {(m.metric, m.region): float(m.values[0]) for m in SeamJump("head", patch_count=20)(given)}


def test_the_seam_jump_sees_patches_apart_and_no_smooth_error() -> None:
    neutral, faces = head(1), ball()[1]
    patches = contiguous_patches(faces, len(neutral), 20, seed=0)
    apart = np.zeros_like(neutral)
    for patch, x in zip(patches, np.random.default_rng(0).normal(size=len(patches)), strict=True):
        apart[patch, 0] = x
    small, large = seams(apart, neutral, faces), seams(2 * apart, neutral, faces)
    assert small["seam_jump", "beside"] == pytest.approx(0, abs=1e-12)
    assert small["seam_excess", "borders"] == pytest.approx(small["seam_jump", "borders"])
    assert small["seam_jump", "borders"] > 0.5
    assert large["seam_excess", "borders"] == pytest.approx(2 * small["seam_excess", "borders"])
    moved = seams(apart + np.array([1.0, 2, 3]), neutral, faces)
    assert moved == pytest.approx(small, abs=1e-9)
    assert set(seams(np.zeros_like(neutral), neutral, faces).values()) == {0.0}
    smooth = seams(10 * np.sin(neutral / 40), neutral, faces)
    assert abs(smooth["seam_excess", "borders"]) < 0.05 * smooth["seam_jump", "borders"]


@pytest.mark.parametrize(
    ("metric", "reason"),
    [
        (EyeAperture(["eye_opening_left"]), "no patches eye_opening_left"),
        (LipError("lips", "lip_contour"), "no loops lip_contour"),
        (LipError("mouth", "lip_contour"), "no vertices mouth"),
        (SeamJump("face"), "no vertices face"),
        (SeamJump("head"), None),
    ],
)
def test_a_metric_says_what_a_topology_lacks(metric: Metric, reason: str | None) -> None:
    said = metric.unsupported(REGIONS)
    assert said is None if reason is None else reason in str(said)
