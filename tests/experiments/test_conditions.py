"""Noise reaches methods and nothing else; one comparison for each set of dataset settings."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from experiments import run as run_module
from experiments.alm_study import AlmStudy, cases
from experiments.backend import Serial
from experiments.catalogue import composed
from experiments.compute import compute
from experiments.conditions import by_condition
from experiments.plan import plan
from experiments.record import FRAMES, RECORD
from experiments.study import Row
from experiments.tables import collect
from reports.load import load
from retarget.check import InvalidInput
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetResult, SolveInfo
from tests.experiments.test_study_run import METRIC, STUDY
from tests.experiments.toy import Toy, toy

ONE_COUNT = replace(STUDY, n_examples=(5,), draws=1)


def noisy(amount: float) -> Toy:
    data = toy()
    return replace(data, conditions=replace(data.conditions, noise_mm=amount))


@dataclass(frozen=True)
class Spy(Retargeter):
    """Delta transfer that keeps all that it was shown."""

    seen: list[FloatArray] = field(default_factory=list)

    def prepare(self, pair: Pair) -> SpyPrepared:
        self.seen.extend((pair.source_neutral[None], pair.target_neutral[None]))
        return SpyPrepared(self.seen, pair)


@dataclass(frozen=True)
class SpyPrepared:
    seen: list[FloatArray]
    pair: Pair

    def fit(self, examples: Examples, animation: FloatArray) -> SpyPrepared:
        assert examples.source is not None
        self.seen.extend((examples.target, examples.source, animation))
        return self

    def __call__(self, source_frames: FloatArray, edits: Any = None) -> RetargetResult:
        self.seen.append(source_frames)
        frames = self.pair.target_neutral + source_frames - self.pair.source_neutral
        return RetargetResult(frames, (SolveInfo(),) * len(frames))


def spied(data: Toy, folder: Path) -> tuple[list[FloatArray], pd.DataFrame]:
    spy = Spy()
    planned = plan(ONE_COUNT, data, [Row("delta", {"name": "delta"}, spy)], METRIC, folder)
    compute(planned, Serial(), Console(file=io.StringIO()))
    return spy.seen, collect(planned)[0]


def test_a_method_sees_scans_and_never_the_truth(tmp_path: Path) -> None:
    data = noisy(0.3)
    everyone = range(len(data.expressions))
    clean = np.concatenate([*(data.frames(name, everyone) for name in "abc"), [data.neutral(name) for name in "abc"]])
    scans = np.concatenate(
        [*(data.scanned(name, everyone) for name in "abc"), [data.scanned_neutral(name) for name in "abc"]]
    )
    allowed = {scan.tobytes() for scan in scans}
    shown = np.concatenate(spied(data, tmp_path)[0])
    assert len(shown) > 100
    assert all(frame.tobytes() in allowed for frame in shown)
    assert not {frame.tobytes() for frame in clean} & {frame.tobytes() for frame in shown}


def test_errors_are_measured_against_the_truth_without_noise(tmp_path: Path) -> None:
    data = noisy(0.3)
    _, metrics = spied(data, tmp_path)
    row = metrics[(metrics.method == "delta") & (metrics.region == "head")].iloc[1]
    i = [data.expressions.index(row.expression)]
    moved = data.scanned_neutral(row.target) + data.scanned(row.source, i)[0] - data.scanned_neutral(row.source)
    expected = np.linalg.norm(moved - data.frames(row.target, i)[0], axis=1).mean()
    assert row.value == pytest.approx(expected, abs=1e-12)
    assert set(metrics["noise_mm"]) == {0.3}
    still = metrics[(metrics.method == "neutral") & (metrics.region == "head")].iloc[1]
    motion = data.frames(still.target, [data.expressions.index(still.expression)])[0] - data.neutral(still.target)
    assert still.value == pytest.approx(np.linalg.norm(motion, axis=1).mean(), abs=1e-12)


def test_kept_frames_show_the_truth_without_noise(tmp_path: Path) -> None:
    data = noisy(0.3)
    spied(data, tmp_path)
    with np.load(next(tmp_path.glob(f"*/{FRAMES}"))) as frames:
        i = [data.expressions.index(str(name)) for name in frames["expressions"]]
        np.testing.assert_allclose(frames["truth"], data.frames("b", i), atol=1e-4)
        np.testing.assert_allclose(frames["target_neutral"], data.neutral("b"), atol=1e-4)
        np.testing.assert_allclose(frames["source"], data.scanned("a", i), atol=1e-4)


def test_noise_of_zero_changes_no_bit(tmp_path: Path) -> None:
    seen, metrics = spied(noisy(0.0), tmp_path / "zero")
    as_before, before = spied(toy(), tmp_path / "none")
    pd.testing.assert_frame_equal(metrics, before)
    for mine, other in zip(seen, as_before, strict=True):
        np.testing.assert_array_equal(mine, other)


def test_studies_of_single_pairs_keep_shapes_of_both_kinds() -> None:
    data = noisy(0.3)
    study = AlmStudy(name="", title="", description="", seed=0, pairs=1, expressions=2, shapes=6)
    case, quiet = next(cases(study, data)), next(cases(study, toy()))
    assert case.names == quiet.names  # the same examples in the same order, whatever the noise
    indices = [data.expressions.index(name) for name in case.names]
    np.testing.assert_array_equal(case.shapes.target, data.scanned(case.target, indices))
    np.testing.assert_array_equal(case.true_shapes, data.frames(case.target, indices))
    np.testing.assert_array_equal(case.truth, quiet.truth)
    np.testing.assert_array_equal(case.pair.target_neutral, data.scanned_neutral(case.target))


STUDIES = [
    "study=noise",
    "method=[delta,plbs]",
    "metric=[vertex_l2]",
    "metric.vertex_l2.regions=[head]",
    "report=false",
]


def noise_study(*overrides: str) -> DictConfig:
    return composed("run", [*STUDIES, "scale=small", "study.n_examples=[5]", "study.draws=1", *overrides])


def console() -> Console:
    return Console(file=io.StringIO(), width=160)


@pytest.fixture
def from_toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "_dataset", lambda config, console: noisy(config.dataset.noise_mm))


@pytest.mark.usefixtures("from_toys")
def test_each_condition_has_results_of_its_own(tmp_path: Path) -> None:
    out = console()
    run_module.run(noise_study("backend=serial"), tmp_path, out)
    said = out.file.getvalue()  # type: ignore[attr-defined]
    assert "3 conditions, 72 cells; estimated time: no earlier cells" in said
    assert said.count("no earlier cells") == 2  # of all, and of the first condition; the others are judged by it
    studies = load([tmp_path / name for name in ("clean", "um_100", "um_300")])
    assert [study.differs for study in studies] == [f"dataset.noise_mm={amount}" for amount in (0.0, 0.1, 0.3)]
    means = [study.primary.set_index("method")["mean"] for study in studies]
    assert means[0]["delta"] < means[1]["delta"] < means[2]["delta"]
    assert means[0]["neutral"] == pytest.approx(means[2]["neutral"])
    assert studies[0].facts["config"]["study"]["kind"] == "comparison"
    written = {path: path.stat().st_mtime_ns for path in tmp_path.rglob(RECORD)}
    next(iter(written)).unlink()
    again = console()
    run_module.run(noise_study("backend=serial"), tmp_path, again)
    said = again.file.getvalue()  # type: ignore[attr-defined]
    assert "for the 1 cells left" in said or "nothing left to compute" in said
    assert sum(path.stat().st_mtime_ns != at for path, at in written.items()) == 1


def test_a_condition_that_cannot_be_stops_the_study_before_it_computes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = noise_study("backend=serial")
    config.study.conditions["um_300"] = {"noise_mm": -1.0}

    def refuse(config: DictConfig, console: Console) -> Toy:
        if config.dataset.noise_mm < 0:
            raise InvalidInput("dataset.noise_mm: no")
        return noisy(config.dataset.noise_mm)

    monkeypatch.setattr(run_module, "_dataset", refuse)
    with pytest.raises(InvalidInput, match="noise_mm: no"):
        run_module.run(config, tmp_path, console())
    assert not list(tmp_path.rglob(RECORD))


def test_conditions_differ_in_their_dataset_alone() -> None:
    config = noise_study("dataset.first_seed=3")
    conditions = by_condition(config)
    assert list(conditions) == ["clean", "um_100", "um_300"]
    for condition, amount in zip(conditions.values(), (0.0, 0.1, 0.3), strict=True):
        assert condition.dataset.noise_mm == amount
        assert condition.dataset.first_seed == 3
        assert condition.dataset.identities == config.scale.identities
        assert "conditions" not in condition.study
    assert config.study.kind == "conditions"  # the study's own configuration is left as it was


def _nothing(config: DictConfig) -> None:
    config.study.conditions = {}


def _unknown(config: DictConfig) -> None:
    config.study.conditions = {"loud": {"noise_m": 0.3}}


def _no_settings(config: DictConfig) -> None:
    config.study.conditions = {"loud": 0.3}


def _outside(config: DictConfig) -> None:
    config.study.conditions = {"../loud": {"noise_mm": 0.3}}


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (_nothing, r"study\.conditions: expected settings of the dataset by the names"),
        (_unknown, r"study\.conditions\.loud.*noise_m"),
        (_no_settings, r"study\.conditions\.loud: expected settings"),
        (_outside, r"study\.conditions\.\.\./loud: expected a name of letters"),
    ],
)
def test_conditions_that_cannot_be_are_refused(break_it: Callable[[DictConfig], None], words: str) -> None:
    config = noise_study()
    OmegaConf.set_struct(config, False)
    break_it(config)
    with pytest.raises(InvalidInput, match=words):
        by_condition(config)


@pytest.mark.parametrize("name", ["truths", "noise", "weights"])
def test_the_studies_of_conditions_name_settings_of_the_dataset(name: str) -> None:
    assert len(by_condition(composed("run", [f"study={name}"]))) >= 3
