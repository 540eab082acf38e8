"""The printed table: means, intervals, and cells without a result."""

from __future__ import annotations

import io
from pathlib import Path

import pandas as pd
from rich.console import Console

from reports.terminal import print_solves, print_summary
from reports.text import estimate, number, p_value, seconds
from tests.reports.example_study import write_example_study


def test_the_table_shows_estimates_and_failures(tmp_path: Path) -> None:
    folder = write_example_study(tmp_path / "study")
    summary = pd.read_csv(folder / "summary.csv")
    text = _printed(summary, 140)
    lines = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert lines["sumner_popovic"].split()[-3:] == ["no", "result", "24"]
    row = summary[(summary["method"] == "plbs") & (summary["n_examples"] == 5) & (summary["region"] == "head")]
    assert f"{row[row['metric'] == 'vertex_l2_mean']['mean'].iloc[0]:.3f} [" in lines["plbs"]
    assert "over 11 or 12 ordered pairs" in text


def test_nothing_is_cut_in_a_narrow_terminal(tmp_path: Path) -> None:
    folder = write_example_study(tmp_path / "study")
    summary = pd.read_csv(folder / "summary.csv")
    wide, narrow = (_printed(summary, width) for width in (140, 80))
    assert "…" not in narrow
    assert sorted(wide.replace("─", "").split()) == sorted(narrow.replace("─", "").split())


def test_correspondences_have_tables_of_their_own_and_solves_are_counted(tmp_path: Path) -> None:
    summary = pd.read_csv(write_example_study(tmp_path / "study") / "summary.csv")
    text = _printed(pd.concat([summary, summary.assign(correspondence="embedded")]), 140)
    assert text.count("region head, given examples") == text.count("region head, embedded examples") == 1
    assert "given" not in _printed(summary, 140)
    counts = {"solves": [5, 5, 5], "solves_not_converged": [0, 2, 0], "solves_failed": [0, 1, 0]}
    file = io.StringIO()
    print_solves(pd.DataFrame({"method": ["plbs", "adt", "adt"], **counts}), Console(file=file, width=140))
    assert file.getvalue() == "adt: of 10 solves 2 stopped at the iteration limit, 1 failed\n"


def _printed(summary: pd.DataFrame, width: int) -> str:
    file = io.StringIO()
    print_summary(summary, Console(file=file, width=width))
    return file.getvalue()


def test_numbers() -> None:
    nan = float("nan")
    assert [number(v) for v in (0.12345, 0.0, 0.0004, -1.0, nan)] == ["0.123", "0.000", "0.0004", "−1.000", "n/a"]
    assert [p_value(p) for p in (0.5, 0.0312, 0.00098, 1e-6, nan)] == [
        "0.500", "0.031", "0.00098", "< 0.0001", "not testable"
    ]  # fmt: skip
    assert [seconds(s) for s in (0.0021, 2.0, 4e-5, nan)] == ["2.1 ms", "2 s", "40 µs", "n/a"]
    assert seconds(0.556, 0.419, 2.07) == "419 – 2070"  # in the unit of the first
    assert seconds(4000) == "4000 s"
    assert estimate(1, 0.5, 2) == "1.000 [0.500, 2.000]"
    assert [estimate(nan, 1, 2), estimate(1, nan, nan)] == ["no result", "1.000 [–]"]
