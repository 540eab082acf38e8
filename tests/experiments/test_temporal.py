"""The study of methods over an animation, on a toy and by hand."""

from __future__ import annotations

import io
import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from experiments import cli
from experiments import run as runner
from experiments.animation import Animated, take
from experiments.catalogue import composed
from experiments.metrics.acceleration import Acceleration, acceleration
from experiments.metrics.identity_spread import identity_spread
from experiments.metrics.metric import Comparison, Disturbed
from experiments.metrics.noise_response import NoiseResponse
from experiments.protocol import draw
from experiments.temporal import TemporalStudy
from reports import report
from reports.temporal_sheet import build_temporal_sheet
from retarget.check import InvalidInput
from retarget.io.principal_shapes import principal_shapes
from retarget.types import FloatArray, Regions
from tests.experiments.toy import Toy, toy

FRAMES = 210


@dataclass(frozen=True)
class RiggedToy(Toy):
    """A toy that performs any weights: the first units of a take."""

    def perform(self, identity: str, weights: FloatArray) -> FloatArray:
        units = self.units[identity]
        return self.neutrals[identity] + np.tensordot(weights[:, 17 : 17 + len(units)], units, axes=1)


def rigged(identities: int = 3) -> RiggedToy:
    data = toy(identities, subdivisions=2)
    return RiggedToy(data.faces, data.regions, data.neutrals, data.units, data.weights)


def settings(*overrides: str) -> list[str]:
    return [
        "study=temporal", f"study.seconds={FRAMES / 30}", "study.noise_frames=20", "method=[delta,lbs]", "report=false",
        "metric.vertex_l2.regions=[head,lips]", "metric.relative_error.regions=[head]", "study.n_examples=[5]",
        "study.references=[neutral]",
        *overrides,
    ]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the study leaves behind for three people."""
    folder = tmp_path_factory.mktemp("temporal")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "_dataset", lambda config, console: rigged())
        runner.run(composed("run", settings()), folder, Console(file=io.StringIO()))
    return folder


def test_every_frame_is_retargeted_in_order_and_recorded(folder: Path) -> None:
    metrics = pd.read_parquet(folder / "metrics.parquet")
    here = metrics[(metrics["metric"] == "vertex_l2_mean") & (metrics["region"] == "head")]
    cells = here.groupby(["method", "source", "target"])["expression"].agg(list)
    assert len(cells) == 3 * 6  # two methods, the still face, six pairs
    assert all(names == [f"frame-{i:04d}" for i in range(FRAMES)] for names in cells)
    assert np.isfinite(metrics["value"]).all()
    summary = pd.read_csv(folder / "summary.csv").set_index(["method", "metric", "region"])["mean"]
    assert summary["neutral", "acceleration_error", "head"] == pytest.approx(100)
    assert summary["neutral", "acceleration_excess", "head"] < -0.5
    assert summary["delta", "noise_response", "head"] == pytest.approx(1)  # a displacement is passed on as it is
    assert 0 < summary["lbs", "noise_response", "head"] < 0.5  # five blendshapes cannot follow noise


def test_identity_is_compared_over_the_sources_of_one_target(folder: Path) -> None:
    table = pd.read_csv(folder / "identity.csv")
    assert table["sources"].tolist() == [2] * 9  # three methods, three targets
    least, most = (table.groupby("method")["spread_mm"].agg(name).to_dict() for name in ("min", "max"))
    assert most["neutral"] == 0
    assert min(least["delta"], least["lbs"]) > 0.05


def test_the_animation_and_the_page_are_there(folder: Path) -> None:
    glb = (folder / "animation.glb").read_bytes()
    assert glb[:4] == b"glTF"
    scene = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])
    assert [node["name"] for node in scene["nodes"]] == ["source", "truth", "delta", "lbs"]
    places = [node["translation"][0] for node in scene["nodes"]]
    assert np.diff(places).min() > 0.16  # m, the width of a head: side by side
    (animation,) = scene["animations"]
    assert [channel["target"]["node"] for channel in animation["channels"]] == [0, 1, 2, 3]
    assert {scene["accessors"][sampler["input"]]["count"] for sampler in animation["samplers"]} == {FRAMES}


def test_the_command_report_makes_the_pages_again_from_files_alone(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page, sheet = folder / "temporal.pdf", folder / "temporal.sheet"
    before = page.read_bytes()
    page.unlink()
    shutil.rmtree(sheet)
    seen = []
    monkeypatch.setattr(report, "build_report", lambda inputs, output, progress: seen.extend(inputs) or folder)
    monkeypatch.setattr(sys, "argv", ["experiments", "report", str(folder.parent)])
    cli.main()
    assert seen == [folder.parent]
    assert page.read_bytes() == before
    assert (sheet / "content.json").exists()
    assert str(page) in capsys.readouterr().out.replace("\n", "")


def test_a_folder_without_the_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"study\.json: this file is missing"):
        build_temporal_sheet(tmp_path)


def described(**changes: object) -> TemporalStudy:
    config = composed("run", settings())
    values = {**runner._study(config), "reference": "lbs", **changes}
    return TemporalStudy.from_config(values)


def test_examples_are_those_of_the_comparison_and_tests_are_all_frames() -> None:
    study, data = described(), rigged()
    animated = study.data(data)
    drawn = study.draw("a", "b", 0, len(animated.expressions))
    assert drawn.test == tuple(range(40, 40 + FRAMES))
    assert drawn.order == draw("a", "b", 0, 40, 5, 0).order
    frames = animated.frames("a", [3, 40, 60])
    np.testing.assert_array_equal(frames[0], data.frames("a", [3])[0])
    np.testing.assert_array_equal(frames[1:], data.perform("a", study.performed.weights[[0, 20]]))
    other = described(animation_seed=2).data(data)
    assert animated.fingerprint not in (data.fingerprint, other.fingerprint)


def test_noise_has_the_length_that_was_asked_for_and_differs_from_frame_to_frame() -> None:
    study, data = described(), rigged()
    noise = study.noise(data, "a")
    assert noise is not None
    assert noise.shape == (20, 162, 3)
    assert np.sqrt((noise**2).sum(axis=2).mean()) == pytest.approx(0.1, rel=0.02)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.3
    assert described(noise_mm=0.0).noise(data, "a") is None


def test_methods_that_can_start_from_the_frame_before_do_so() -> None:
    methods = {name: composed(f"method/{name}").method[name] for name in ("delta", "adt")}
    rows = {row.name: row for row in described().rows(methods)}
    assert rows["adt"].settings["streaming"] is True
    assert "streaming" not in rows["delta"].settings
    assert described(streaming=False).rows(methods)[1].settings["streaming"] is False


def test_a_conversation_goes_on_where_its_part_starts() -> None:
    whole, part = take(None, 0.0, 10.0, None, 3), take(None, 2.0, 8.0, None, 3)
    assert (whole.fps, len(whole.weights), len(part.weights)) == (30.0, 300, 240)
    np.testing.assert_allclose(part.weights, whole.weights[60:], atol=1e-12)
    np.testing.assert_allclose(part.times[:3], [0, 1 / 30, 2 / 30])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"seconds": 3.0}, "at least 200 frames, got 90"),
        ({"seconds": "long"}, r"study\.seconds: expected more than 0, got 'long'"),
        ({"start": -1.0}, r"study\.start: expected 0 or more"),
        ({"fps": 0}, r"study\.fps"),
        ({"recording": "nowhere.csv"}, "nowhere.csv"),
        ({"noise_mm": -1}, r"study\.noise_mm"),
        ({"noise_frames": 0}, r"study\.noise_frames"),
    ],
)
def test_animations_that_cannot_be_are_refused(changes: dict[str, object], said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        described(**changes)


def test_a_dataset_of_scans_is_refused() -> None:
    with pytest.raises(InvalidInput, match="dataset toy: study=temporal needs identities that perform"):
        Animated.of(toy(), take(None, 0.0, 8.0, None, 1))


# The metrics by hand.

REGIONS = Regions(vertices={"head": np.arange(2)})
STILL = np.zeros((2, 3))


def moving(heights: list[float], amount: float = 1.0) -> FloatArray:
    """(t, 2, 3) two vertices that go up and down together."""
    return amount * np.array(heights)[:, None, None] * np.array([0.0, 1.0, 0.0]) * np.ones((1, 2, 1))


def compared(
    found: FloatArray,
    true: FloatArray,
    source: FloatArray,
    disturbed: Disturbed | None = None,
    ordered: bool = True,
) -> Comparison:
    faces = np.array([[0, 1, 1]])
    return Comparison(found, true, source, STILL, STILL, faces, REGIONS, ordered, disturbed)


def values(metric: Acceleration | NoiseResponse, given: Comparison) -> dict[str, list[float]]:
    return {m.metric: m.values.round(9).tolist() for m in metric(given)}


def test_acceleration_by_hand() -> None:
    true = moving([0, 0, 1, 3, 5])  # accelerates by 1, 1, 0
    np.testing.assert_allclose(acceleration(true)[:, 0, 1], [1, 1, 1, 0, 0])
    np.testing.assert_array_equal(acceleration(true[:2]), 0)
    found = values(Acceleration("head"), compared(2 * true, true, 4 * true))
    assert found["acceleration_error"] == pytest.approx([100 / 0.6, 100 / 0.6, 100 / 0.6, 0, 0])
    assert found["acceleration_excess"] == pytest.approx([1 / 2.4, 1 / 2.4, 1 / 2.4, 0, 0])
    still = values(Acceleration("head"), compared(0 * true, true, true))
    assert np.mean(still["acceleration_error"]) == pytest.approx(100)
    assert np.mean(still["acceleration_excess"]) == pytest.approx(-1)
    offset = values(Acceleration("head"), compared(true + 7, true, true))
    assert set(offset["acceleration_error"]) == {0.0}


def test_more_jitter_scores_worse() -> None:
    true = moving([0, 1, 3, 4, 4, 2, 0])
    jitter = np.random.default_rng(0).normal(size=true.shape)
    scores = [values(Acceleration("head"), compared(true + a * jitter, true, true)) for a in (0.0, 0.5, 1.0)]
    for name in ("acceleration_error", "acceleration_excess"):
        first, second, third = (np.mean(score[name]) for score in scores)
        assert first < second < third


def test_more_answer_to_noise_scores_worse() -> None:
    frames, rng = moving([0, 1, 2, 3]), np.random.default_rng(0)
    noise, own = rng.normal(size=(3, 2, 3)), rng.normal(size=(3, 2, 3))
    answers = [Disturbed(noise, frames[:3] + a * own) for a in (0.0, 0.5, 1.0)]
    scores = [
        values(NoiseResponse("head"), compared(frames, frames, frames, disturbed=answer))["noise_response"][0]
        for answer in answers
    ]
    assert scores[0] == 0
    assert scores == sorted(set(scores))


def test_noise_response_by_hand() -> None:
    frames = moving([0, 1, 2, 3])
    noise = np.array([[[0, 3, 4], [0, 0, 0]], [[0, 0, 0], [3, 0, 4]]], dtype=float)
    for gain in (0.0, 0.5, 2.0):
        given = compared(frames, frames, frames, disturbed=Disturbed(noise, frames[:2] + gain * noise[:, ::-1]))
        assert values(NoiseResponse("head"), given) == {"noise_response": [gain] * 4}
    assert values(NoiseResponse("head"), compared(frames, frames, frames)) == {"noise_response": [0.0] * 4}


@pytest.mark.parametrize("metric", [Acceleration("head"), NoiseResponse("head")])
def test_single_expressions_have_no_time(metric: Acceleration | NoiseResponse) -> None:
    frames = moving([0, 1, 2])
    with pytest.raises(InvalidInput, match="study=temporal"):
        list(metric(compared(frames, frames, frames, ordered=False)))


def test_identity_spread_by_hand() -> None:
    frames = np.zeros((2, 1, 2, 3))
    frames[1, 0, 0] = [0, 3, 4]  # one of two vertices, 5 mm apart
    assert identity_spread(frames) == pytest.approx(np.sqrt(2 * 2.5**2 / 2))
    assert identity_spread(2 * frames) == pytest.approx(2 * identity_spread(frames))
    assert identity_spread(frames[:1].repeat(3, axis=0)) == 0
    rng = np.random.default_rng(0)
    many = identity_spread(rng.normal(size=(12, 4, 500, 3)))
    assert many == pytest.approx(np.sqrt(3), rel=0.02)  # unbiased: as for 2 sources
    assert identity_spread(rng.normal(size=(2, 4, 500, 3))) == pytest.approx(many, rel=0.05)


def test_principal_shapes_keep_every_vertex_within_the_tolerance() -> None:
    data = rigged(1)
    weights = take(None, 0.0, 8.0, None, 1).weights
    frames, times = data.perform("a", weights), np.arange(len(weights)) / 30
    mesh = principal_shapes("a", data.neutral("a"), frames, times, tolerance=0.05)
    assert 1 <= len(mesh.shape_names) <= 8  # of eight units
    assert np.abs(mesh.weights).max() <= 1 + 1e-12
    shown = np.array([mesh.at(k) for k in range(len(times))])
    assert np.linalg.norm(shown - frames, axis=2).max() <= 0.05
    still = principal_shapes("a", data.neutral("a"), np.stack([data.neutral("a")] * 4), times[:4])
    np.testing.assert_allclose(still.at(3), data.neutral("a"))
