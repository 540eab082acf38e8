"""A study on a toy dataset: cells, failures, resumption, identical bits."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hydra.errors import InstantiationException
from rich.console import Console

from experiments import plan as plan_module
from experiments.backend import Backend, Joblib, Serial
from experiments.catalogue import composed, method_settings
from experiments.compute import compute
from experiments.correspondence import Embedded, EmbeddingSettings, Known
from experiments.metrics.eye_aperture import EyeAperture
from experiments.metrics.metric import Comparison, Measurement, Metric
from experiments.metrics.vertex_l2 import VertexL2
from experiments.plan import Plan, plan
from experiments.record import FRAMES, RECORD
from experiments.run import _plain
from experiments.study import Figures, Row, Study
from experiments.tables import _describe, collect
from reports.cells import METRIC_COLUMNS
from retarget.check import InvalidInput
from retarget.io.files import check_folder
from retarget.types import (
    Examples,
    FloatArray,
    Pair,
    Retargeter,
    RetargetProblem,
    RetargetResult,
    SolveInfo,
    Status,
)
from tests.experiments.toy import Toy, toy

STUDY = Study(
    name="toy",
    title="A toy study",
    description="",
    seed=0,
    n_examples=(2, 5),
    draws=2,
    test_expressions=3,
    correspondence=("given",),
    span="animation",
    references=("neutral", "projection_bound"),
    reference="delta",
    primary_metric="vertex_l2_mean",
    primary_region="head",
    primary_family=("delta",),
    figures=Figures(pairs=1, draws=1),
)
METRIC: dict[str, tuple[Metric, dict[str, Any]]] = {
    "vertex_l2": (VertexL2(["mean"], ["head", "lips"]), {"statistics": ["mean"]})
}


@dataclass(frozen=True)
class Delta(Retargeter):
    """Delta transfer in its simplest form, that can be told to misbehave."""

    mischief: str = ""
    calls: Path | None = None  # a folder in which each pair leaves a file

    def unsupported(self, problem: RetargetProblem) -> str | None:
        return "needs five examples" if self.mischief == "picky" and len(problem.target_examples) < 5 else None

    def prepare(self, pair: Pair) -> DeltaPrepared:
        if self.mischief == "prepare":
            raise RuntimeError("no memory for the factor")
        if self.calls:
            name = hash((pair.source_neutral.tobytes(), pair.target_neutral.tobytes()))
            (self.calls / str(name)).touch()
        return DeltaPrepared(self.mischief, pair)


@dataclass(frozen=True)
class DeltaPrepared:
    mischief: str
    pair: Pair

    def fit(self, examples: Examples, animation: FloatArray) -> DeltaPrepared:
        if self.mischief == "fit":
            raise ValueError("singular")
        return self

    def __call__(self, source_frames: FloatArray, edits: Any = None) -> RetargetResult:
        frames = self.pair.target_neutral + source_frames - self.pair.source_neutral
        if self.mischief == "nan":
            frames[0, 0] = np.nan
        ended = {"slow": Status.MAX_ITERATIONS, "lost": Status.FAILED}
        status = ended.get(self.mischief, Status.CONVERGED)
        return RetargetResult(frames, tuple(SolveInfo(status, 3, (2.0, 1.0)) for _ in frames))


def planned(
    folder: Path, dataset: Toy | None = None, study: Study = STUDY, methods: dict[str, Retargeter] | None = None
) -> Plan:
    rows = [Row(name, {"name": name}, method) for name, method in (methods or {"delta": Delta()}).items()]
    return plan(study, dataset or toy(), rows, METRIC, folder)


def run(the_plan: Plan, backend: Backend | None = None) -> tuple[pd.DataFrame, pd.DataFrame]:
    compute(the_plan, backend or Serial(), Console(file=io.StringIO()))
    return collect(the_plan)


def test_every_cell_of_every_ordered_pair_has_its_rows(tmp_path: Path) -> None:
    metrics, cells = run(planned(tmp_path))
    assert tuple(metrics.columns) == METRIC_COLUMNS
    assert len(cells) == 6 * 3 * 2 * 2  # ordered pairs x (delta, neutral, bound) x counts x draws
    assert len(metrics) == len(cells) * 3 * 2  # test expressions x regions
    assert set(cells["status"]) == {"ok"}
    assert metrics["value"].notna().all()


def test_the_measured_error_is_the_distance_to_the_truth(tmp_path: Path) -> None:
    data = toy()
    metrics, _ = run(planned(tmp_path, data))
    row = metrics[(metrics.method == "delta") & (metrics.region == "head")].iloc[7]
    i = [data.expressions.index(row.expression)]
    moved = data.neutral(row.target) + data.frames(row.source, i)[0] - data.neutral(row.source)
    assert row.value == pytest.approx(np.linalg.norm(moved - data.frames(row.target, i)[0], axis=1).mean(), abs=1e-12)
    neutral = metrics[(metrics.method == "neutral") & (metrics.region == "head")].set_index(
        ["source", "target", "draw", "n_examples", "expression"]
    )
    motion = np.linalg.norm(data.frames(row.target, i)[0] - data.neutral(row.target), axis=1).mean()
    key = (row.source, row.target, row.draw, row.n_examples, row.expression)
    assert neutral.loc[key, "value"] == pytest.approx(motion)


def test_the_projection_bound_falls_with_more_examples_and_vanishes_when_they_span_the_truth(tmp_path: Path) -> None:
    metrics, _ = run(planned(tmp_path, study=replace(STUDY, n_examples=(2, 5, 30))))
    bound = metrics[metrics.method == "projection_bound"].groupby("n_examples")["value"].mean()
    assert bound[2] > bound[5] > 1e-2
    assert bound[30] < 1e-4  # 30 examples span 8 units


@pytest.mark.parametrize(
    ("mischief", "status", "words"),
    [
        ("prepare", "failed", "prepare: RuntimeError: no memory for the factor"),
        ("fit", "failed", "ValueError: singular"),
        ("nan", "failed", "NaN or infinite"),
        ("slow", "not_converged", "3 of 3 solves stopped at their iteration limit"),
    ],
)
def test_a_method_that_fails_is_a_cell_with_its_reason(tmp_path: Path, mischief: str, status: str, words: str) -> None:
    metrics, cells = run(planned(tmp_path, methods={"delta": Delta(), "odd": Delta(mischief)}))
    odd = cells[cells.method == "odd"]
    assert set(odd["status"]) == {status}
    assert odd["reason"].str.contains(words).all()
    values = metrics[metrics.method == "odd"]["value"]
    assert len(values) == len(metrics[metrics.method == "delta"])
    assert values.isna().all() if status == "failed" else values.notna().all()
    assert set(cells[cells.method == "delta"]["status"]) == {"ok"}


def test_an_unsupported_problem_is_a_cell_with_its_reason(tmp_path: Path) -> None:
    _, cells = run(planned(tmp_path, methods={"delta": Delta("picky")}))
    delta = cells[cells.method == "delta"].set_index("n_examples")
    assert set(delta.loc[2, "status"]) == {"unsupported"}
    assert set(delta.loc[2, "reason"]) == {"needs five examples"}
    assert set(delta.loc[5, "status"]) == {"ok"}


def test_finished_cells_are_not_computed_again_and_missing_ones_are(tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    calls.mkdir()
    first = planned(tmp_path, methods={"delta": Delta(calls=calls)})
    whole = run(first)
    assert len(list(calls.iterdir())) == 6
    for file in calls.iterdir():
        file.unlink()
    lost = [cell for cell in first.cells if cell.row.name == "delta" and (cell.source, cell.target) == ("a", "b")]
    for cell in lost[:2]:
        (tmp_path / cell.id / RECORD).unlink()
    again = run(planned(tmp_path, methods={"delta": Delta(calls=calls)}))
    assert len(list(calls.iterdir())) == 1
    pd.testing.assert_frame_equal(again[0], whole[0])
    assert again[1]["prediction"].tolist() == whole[1]["prediction"].tolist()


@pytest.mark.parametrize("change", ["data", "code", "settings", "seed"])
def test_a_cell_is_reused_only_if_id_code_and_data_match(
    tmp_path: Path, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(planned(tmp_path))
    data, study, rows = toy(), STUDY, {"delta": Delta()}
    if change == "data":
        data = replace(data, fingerprint="other")
    elif change == "code":
        monkeypatch.setattr(plan_module, "code_hash", lambda: "other")
    elif change == "settings":
        rows = {"delta_2": Delta()}
        study = replace(study, reference="delta_2")
    else:
        study = replace(study, seed=1)
    changed = planned(tmp_path, data, study, rows)
    assert all(changed.finished(cell) is None for cell in changed.cells if cell.row.method)


def test_parallel_and_serial_runs_give_the_same_bits(tmp_path: Path) -> None:
    rows = {"delta": _packaged_delta()}
    serial, parallel = planned(tmp_path / "s", methods=rows), planned(tmp_path / "p", methods=rows)
    one, two = run(serial, Serial()), run(parallel, Joblib(jobs=2))
    pd.testing.assert_frame_equal(one[0], two[0])
    assert one[1]["prediction"].tolist() == two[1]["prediction"].tolist()


def _packaged_delta() -> Retargeter:
    from baselines.delta_transfer import DeltaTransfer

    return DeltaTransfer()


@pytest.mark.parametrize("settings", [{"jobs": 0}, {"jobs": "x"}, {"threads": -1}, {"threads": True}])
def test_a_backend_without_a_number_is_refused(settings: dict[str, Any]) -> None:
    (name,) = settings
    with pytest.raises(InvalidInput, match=f"backend.{name}: expected a whole number"):
        Joblib(**settings)
    assert Joblib(jobs=-2).jobs == -2


def test_marked_frames_are_kept_beside_their_record(tmp_path: Path) -> None:
    data = toy()
    the_plan = planned(tmp_path, data)
    run(the_plan)
    kept = [cell for cell in the_plan.cells if (tmp_path / cell.id / FRAMES).exists()]
    assert {(cell.source, cell.target, cell.draw) for cell in kept} == {("a", "b", 0)}
    with np.load(tmp_path / kept[0].id / FRAMES, allow_pickle=False) as frames:
        assert frames["truth"].shape == frames["retargeted"].shape == frames["source"].shape == (3, 642, 3)
        i = [data.expressions.index(name) for name in frames["expressions"]]
        np.testing.assert_allclose(frames["truth"], data.frames("b", i), atol=1e-4)


def bad(vertex: float) -> FloatArray:
    neutral = toy().neutral("b").copy()
    neutral[5, 1] = vertex
    return neutral


@pytest.mark.parametrize(
    ("dataset", "words"),
    [
        (lambda: toy(identities=1), "1 identities, expected at least 2"),
        (lambda: toy().with_neutral("b", bad(np.nan)), r"b, neutral: 1 vertices are NaN or infinite, .* \(5,\)"),
        (lambda: toy().with_neutral("b", bad(np.inf)), "NaN or infinite"),
        (lambda: toy().with_neutral("b", toy(subdivisions=2).neutral("b")), "expected 642 vertices .* got 162"),
        (lambda: toy().with_neutral("b", np.zeros((642, 3))), "b, neutral: 1280 of 1280 triangles are degenerate"),
        (lambda: replace(toy(), faces=toy().faces + 1), "the faces belong to another mesh"),
        (lambda: toy(expressions=7), "5 examples asked for, but the dataset has 7 expressions"),
    ],
)
def test_data_that_no_study_can_use_is_refused_before_anything_runs(tmp_path: Path, dataset: Any, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        planned(tmp_path / "results", dataset())
    assert not (tmp_path / "results").exists()


CONFIG: dict[str, Any] = {**vars(STUDY), "n_examples": [2, 5], "references": ["neutral"], "primary_family": ["plbs"]}
CONFIG |= {"correspondence": "given", "tables": []}
EMBEDDING = {"transfer": "gradient_transfer", "patch_count": None, "lambda_reg": 1e-6, "seed": 0}
EMBEDDED = {"correspondence": "embedded", "embedding": EMBEDDING}
CONFIG |= {"reference": "delta", "figures": {"pairs": 0, "draws": 0}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"n_examples": 5}, r"study\.n_examples: expected a list such as \[5,15\], got 5"),
        ({"n_examples": ["five"]}, "study.n_examples: expected a whole number of at least 0, got 'five'"),
        ({"n_examples": [5.5]}, "got 5.5"),
        ({"n_examples": [-1]}, "got -1"),
        ({"n_examples": [5, 5]}, "expected different counts"),
        ({"n_examples": []}, "expected different counts"),
        ({"test_expressions": 0}, "study.test_expressions: expected a whole number of at least 1"),
        ({"draws": "two"}, "study.draws"),
        ({"seed": -1}, "study.seed"),
        ({"correspondence": "givn"}, "Did you mean 'given'"),
        ({"correspondence": ["given", "embeded"]}, "Did you mean 'embedded'"),
        ({"correspondence": ["given", "given"]}, "study.correspondence: expected different ones"),
        (
            {"correspondence": "embedded", "embedding": {**EMBEDDING, "transfer": "dt"}},
            "study.embedding.transfer: 'dt'",
        ),
        (
            {"correspondence": "embedded", "embedding": {**EMBEDDING, "lambda_reg": 0}},
            "lambda_reg: expected a positive",
        ),
        ({"tables": ["eye_aperture"]}, r"study.tables: expected a list of \[metric, region\], got"),
        ({"measures": {"plbs": "seam_jump"}}, "study.measures.plbs: expected a list"),
        ({"measures": {"plbz": []}}, "study.measures: 'plbz' is unknown, .* Did you mean 'plbs'"),
        ({"figures": {"pairs": 0, "draws": 0, "parts": "anacon"}}, "study.figures.parts: 'anacon' is unknown"),
        ({"span": "all"}, "study.span: 'all' is unknown"),
        ({"references": ["neutrl"]}, "Did you mean 'neutral'"),
        ({"primary_family": ["lbz"]}, "study.primary_family: 'lbz' is unknown, .* Did you mean 'lbs'"),
        (
            {"first_seed": 1000},
            r"study\.first_seed: no setting of this study, expected one of name, title, .* measures\.",
        ),
        ({"drawz": 2}, r"study\.drawz: no setting .* Did you mean 'draws'"),
        ({"figures": {"pair": 0}}, r"study\.figures\.pair: no setting .* pairs, draws, parts\. Did you mean 'pairs'"),
        ({"figures": 3}, "study.figures: expected settings such as {pairs: 2}, got 3"),
    ],
)
def test_values_that_no_study_can_have_are_refused(change: dict[str, Any], words: str) -> None:
    assert Study.from_config(CONFIG).n_examples == (2, 5)
    with pytest.raises(InvalidInput, match=words):
        Study.from_config(CONFIG | change)


@pytest.mark.parametrize(
    ("study", "words"),
    [
        (replace(STUDY, primary_metric="vertex_l2_meen"), "Did you mean 'vertex_l2_mean'"),
        (replace(STUDY, primary_region="chin"), "study.primary_region: 'chin' is unknown, expected one of head, lips"),
        (replace(STUDY, reference="plbs"), r"Add it to method=\[...\], or set study.reference=delta"),
    ],
)
def test_a_study_that_tests_what_nobody_measures_is_refused(tmp_path: Path, study: Study, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        planned(tmp_path, study=study)


@dataclass(frozen=True)
class Broken(Metric):
    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        yield Measurement("broken", "head", "mm", "lower", np.zeros((2, 2)))


def test_a_metric_that_does_not_work_is_found_before_anything_is_computed(tmp_path: Path) -> None:
    rows = [Row("delta", {}, Delta())]
    with pytest.raises(InvalidInput, match=r"metric 'broken' fails on this dataset: .* shape"):
        plan(STUDY, toy(), rows, {**METRIC, "broken": (Broken(), {})}, tmp_path)
    with pytest.raises(InvalidInput, match="region 'chin'"):
        plan(STUDY, toy(), rows, {"vertex_l2": (VertexL2(["mean"], ["head", "chin"]), {})}, tmp_path)


def test_a_metric_that_this_topology_cannot_serve_is_left_out_with_its_reason(tmp_path: Path) -> None:
    rows = [Row("delta", {}, Delta())]
    eyes = EyeAperture(["eye_opening_left"])
    made = plan(STUDY, toy(), rows, {**METRIC, "eye_aperture": (eyes, {"openings": ["eye_opening_left"]})}, tmp_path)
    assert made.left_out == {"eye_aperture": "the regions of this dataset name no patches eye_opening_left"}
    assert made.metrics == (METRIC["vertex_l2"][0],)
    assert [cell.id for cell in made.cells] == [cell.id for cell in plan(STUDY, toy(), rows, METRIC, tmp_path).cells]


@dataclass(frozen=True)
class Spy(Retargeter):
    """Answers as Delta, and refuses unless it was shown the expected number of source frames."""

    frames: int = 0

    def unsupported(self, problem: RetargetProblem) -> str | None:
        seen = len(problem.source_animation)
        return None if seen == self.frames else f"saw {seen} frames"

    def prepare(self, pair: Pair) -> DeltaPrepared:
        return DeltaPrepared("", pair)


@pytest.mark.parametrize(("span", "frames"), [("animation", 40), ("five", 3)])
def test_the_span_decides_how_much_of_the_animation_a_method_sees(tmp_path: Path, span: str, frames: int) -> None:
    _, cells = run(planned(tmp_path, study=replace(STUDY, span=span), methods={"delta": Spy(frames)}))
    assert set(cells["status"]) == {"ok"}


def test_what_a_killed_process_left_half_written_is_cleared_and_a_living_one_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "cell").mkdir()
    dead, alive = (tmp_path / "cell" / f".frames.npz.{pid}.tmp.npz" for pid in (2**22 + 5, os.getpid()))
    dead.touch()
    alive.touch()
    check_folder(tmp_path)
    assert list((tmp_path / "cell").iterdir()) == [alive]


def test_a_results_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("somebody's file")
    with pytest.raises(InvalidInput, match="nothing can be written there"):
        check_folder(tmp_path / "results" / "ci")
    assert (tmp_path / "results").read_text() == "somebody's file"
    check_folder(tmp_path / "fine")
    assert list((tmp_path / "fine").iterdir()) == []


PLBS = {**method_settings("plbs"), "patch_count": 12}


def test_a_variant_is_a_row_with_some_settings_changed(tmp_path: Path) -> None:
    variants = {
        "stiff": {"of": "plbs", "lambda_reg": 1.0},
        "paper": {"of": "plbs_paper", "patch_count": 9},
        "same": {"of": "plbs"},
    }
    study = Study.from_config(CONFIG | {"variants": variants, "reference": "plbs", "primary_family": ["stiff"]})
    rows = {row.name: row for row in study.rows({"plbs": PLBS})}
    assert list(rows) == ["plbs", "stiff", "paper", "same"]
    assert rows["stiff"].settings == {**PLBS, "lambda_reg": 1.0}  # of the method as it was chosen
    assert rows["paper"].settings == {**method_settings("plbs_paper"), "patch_count": 9}
    assert rows["stiff"].description == "plbs with lambda_reg = 1.0."
    made = plan(study, toy(), list(rows.values()), METRIC, tmp_path)
    metrics, cells = run(made)
    error = metrics[metrics["region"] == "head"].groupby("method")["value"].mean()
    assert error["stiff"] > error["plbs"] == error["same"]
    assert cells["cell"].is_unique
    description = {m["name"]: m for m in _describe(made, {"backend": {"threads": 1}}, datetime.now(UTC))["methods"]}
    assert description["stiff"]["description"] == "plbs with lambda_reg = 1.0."
    assert description["stiff"]["settings"]["lambda_reg"] == 1.0


@pytest.mark.parametrize(
    ("variants", "words"),
    [
        ({"soft": {"of": "plbz"}}, r"study\.variants\.soft\.of: 'plbz' is unknown, .* Did you mean 'plbs'"),
        ({"soft": {"of": "plbs", "lambda": 1}}, "study.variants.soft, setting of plbs: 'lambda' .* 'lambda_reg'"),
        ({"soft": {"of": "plbs", "lambda_reg": -1}}, "lambda_reg: expected a positive number"),
        ({"soft": {"lambda_reg": 1}}, "study.variants.soft: expected 'of'"),
        ({"lbs": {"of": "plbs"}}, "study.variants.lbs: there is a row of this name already"),
        ({"neutral": {"of": "plbs"}}, "study.variants.neutral: there is a row"),
    ],
)
def test_variants_that_cannot_be_are_refused(variants: dict[str, Any], words: str) -> None:
    with pytest.raises((InvalidInput, InstantiationException)) as raised:
        Study.from_config(CONFIG | {"variants": variants}).rows({"plbs": PLBS})
    assert re.search(words, str(raised.value.__cause__ or raised.value))


BOTH = CONFIG | {"correspondence": ["given", "embedded"], "embedding": EMBEDDING, "reference": "plbs"}


def test_given_and_embedded_examples_stand_side_by_side(tmp_path: Path) -> None:
    study = Study.from_config(BOTH)
    rows = study.rows({"plbs": PLBS})
    metrics, cells = run(plan(study, toy(), rows, METRIC, tmp_path / "both"))
    head = metrics[(metrics["region"] == "head") & (metrics["method"] == "plbs")]
    error = head.groupby(["correspondence", "n_examples"])["value"].mean()
    assert (error["embedded"] > error["given"]).all()
    neutral = metrics[metrics["method"] == "neutral"].groupby("correspondence")["value"].mean()
    assert neutral["given"] == neutral["embedded"]
    seconds = cells[cells["method"] == "plbs"].groupby("correspondence")["correspondence_seconds"]
    assert seconds.max()["given"] == 0 < seconds.min()["embedded"]
    alone, _ = run(plan(replace(study, correspondence=("embedded",)), toy(), rows, METRIC, tmp_path / "alone"))
    both = metrics[metrics["correspondence"] == "embedded"].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone, both)


def test_embedded_examples_are_the_same_in_whatever_order_they_are_asked_for() -> None:
    data = toy()
    pair = Pair(data.faces, data.neutral("a"), data.neutral("b"), data.regions)
    settings = EmbeddingSettings.from_config(EMBEDDING | {"patch_count": 12})
    source, target = (data.frames(name, range(40)) for name in "ab")

    def known(*indices: int) -> Known:
        i = list(indices)
        return Known(tuple(data.expressions[j] for j in i), source[i], target[i], source)

    one, other = Embedded(pair, settings), Embedded(pair, settings)
    first = one(known(3, 4, 5))
    other(known(5))
    again = other(known(3, 4, 5))
    assert again.examples.tobytes() == first.examples.tobytes()
    assert len(again.solves) == 3
    assert one(known()).examples.shape == (0, 642, 3)
    twin = Embedded(replace(pair, target_neutral=pair.source_neutral), settings)
    np.testing.assert_allclose(twin(replace(known(3, 4), target_examples=source[3:5])).examples, source[3:5], atol=1e-2)


def test_an_embedding_that_fails_is_a_reason_and_leaves_the_references_alone(tmp_path: Path) -> None:
    study = Study.from_config(BOTH)
    broken = replace(study, embedding=EmbeddingSettings(Delta("prepare"), None, 1e-6))
    _, cells = run(plan(broken, toy(), broken.rows({"plbs": PLBS}), METRIC, tmp_path / "broken"))
    status = cells.groupby(["method", "correspondence"])["status"].unique().map(set)
    assert status["plbs", "embedded"] == {"failed"}
    assert status["plbs", "given"] == status["neutral", "embedded"] == {"ok"}
    lost = replace(study, embedding=EmbeddingSettings(Delta("lost"), None, 1e-6))
    _, cells = run(plan(lost, toy(), lost.rows({"plbs": PLBS}), METRIC, tmp_path / "lost"))
    reasons = cells[(cells["method"] == "plbs") & (cells["correspondence"] == "embedded")]["reason"]
    assert reasons.str.contains("embedding of expression_.*: its transfer failed").all()
    unable = replace(study, embedding=EmbeddingSettings(Unable(), None, 1e-6))
    _, cells = run(plan(unable, toy(), unable.rows({"plbs": PLBS}), METRIC, tmp_path / "unable"))
    refused = cells[(cells["method"] == "plbs") & (cells["correspondence"] == "embedded")]
    assert set(refused["status"]) == {"unsupported"}
    assert set(refused["reason"]) == {"no source examples: no head can be made of it"}


@dataclass(frozen=True)
class Unable(Retargeter):
    def prepare(self, pair: Pair) -> DeltaPrepared:
        raise InvalidInput("no head can be made of it")


@pytest.mark.parametrize("name", ["quantitative", "ci", "ablation", "embedding", "sensitivity"])
def test_every_study_of_comparison_can_be_planned(name: str) -> None:
    """Its methods, variants, families and measures exist; report and gate compose it as well."""
    config = composed("run", [f"study={name}"])
    study = Study.from_config({k: v for k, v in _plain(config.study).items() if k != "kind"})
    rows = [row.name for row in study.rows(_plain(config.method))]
    study.check_rows(rows)
    assert set(study.primary_family) <= set(rows)
    assert set(study.measures) <= set(rows)
    for command in ("report", "gate"):
        assert composed(command, [f"study={name}"]).study.name == name


def test_how_solves_ended_is_counted_for_every_cell(tmp_path: Path) -> None:
    methods: dict[str, Retargeter] = {"delta": Delta(), "slow": Delta("slow"), "lost": Delta("lost")}
    _, cells = run(planned(tmp_path, methods=methods))
    counts = ["solves", "solves_not_converged", "solves_failed"]
    for method, expected in {"delta": (3, 0, 0), "slow": (3, 3, 0), "lost": (3, 0, 3)}.items():
        assert (cells.loc[cells["method"] == method, counts].to_numpy() == expected).all()
    assert set(cells[cells["method"] == "lost"]["status"]) == {"failed"}
