"""The pages of a study of the kind `tuning`: its tables by hand, its figures on odd spaces."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pypdf import PdfReader
from rich.console import Console

from reports.terminal import print_tuning
from reports.tuning_sheet import build_tuning_sheet, choice_table, grid_table, markdown, scientific, trial_table
from retarget.check import InvalidInput

SPACES: dict[str, Any] = {
    "lbs": {"lambda_reg": {"log": [1e-8, 1.0]}},
    "plbs": {"lambda_reg": {"log": [1e-8, 1.0]}},
    "adt": {"w_target": {"linear": [0.0, 4.0]}, "tets": {"choices": ["volume", "equal"]}},
    "lost": {"lambda_reg": {"log": [0.5, 8.0]}},
}


def trials() -> pd.DataFrame:
    rows: list[dict[str, Any]] = [
        {"method": "lbs", "trial": 0, "lambda_reg": 2.2e-3, "error_5": 0.6, "error_15": 0.4, "chosen": True},
        {"method": "lbs", "trial": 1, "lambda_reg": 1e-8, "error_5": 0.6, "error_15": 0.39},
        {"method": "plbs", "trial": 0, "lambda_reg": 1e-8, "error_5": 0.3, "error_15": 0.2},
        {"method": "plbs", "trial": 1, "lambda_reg": 2.2e-3, "error_5": 0.2, "error_15": 0.1, "chosen": True},
        {"method": "adt", "trial": 0, "w_target": 1.0, "tets": "volume", "error_5": 0.5, "error_15": 0.5},
        {
            "method": "adt",
            "trial": 1,
            "w_target": 3.5,
            "tets": "equal",
            "error_5": 0.4,
            "error_15": 0.4,
            "chosen": True,
        },
        {"method": "adt", "trial": 2, "w_target": 0.0, "tets": "equal", "n_failed": 2},
        {"method": "lost", "trial": 0, "lambda_reg": 1.0, "n_failed": 4},
        {"method": "delta", "error_5": 0.7, "error_15": 0.7},
    ]
    table = pd.DataFrame(rows).astype({"trial": "Int64"})
    table["chosen"] = table["chosen"].eq(True)
    table["n_failed"] = table["n_failed"].fillna(0).astype(int)
    return table.assign(error=(table["error_5"] + table["error_15"]) / 2)


def found() -> dict[str, pd.DataFrame]:
    table = trials()
    return {method: table[table["method"] == method].reset_index(drop=True) for method in SPACES}


def test_the_choice_stands_beside_the_present_and_the_smallest() -> None:
    assert choice_table(found(), SPACES, [5, 15]).rows == (
        ("lbs", "as it is (lambda_reg 2.2e-3)", "0.5000", "0.5000", "0.4950", "1"),
        ("plbs", "lambda_reg 2.2e-3", "0.1500", "0.2500", "0.1500", "1"),
        ("adt", "trial 1", "0.4000", "0.5000", "0.4000", "1"),
        ("lost", "none: no trial finished", "", "n/a", "", ""),
    )


def test_methods_on_the_same_grid_stand_side_by_side_in_order() -> None:
    table = grid_table({name: found()[name] for name in ("lbs", "plbs")}, "lambda_reg", [5, 15])
    assert table.heads == ("lambda_reg", "lbs", "plbs")
    assert table.rows == (
        ("1.0e-8", "0.600 / 0.390", "0.300 / 0.200"),
        ("2.2e-3", "0.600 / 0.400 *", "0.200 / 0.100 *"),
    )


def test_trials_of_a_space_are_ordered_by_their_error_and_failures_are_told() -> None:
    table = trial_table(found()["adt"], ["w_target", "tets"], "adt", [5, 15])
    assert table.rows == (
        ("1 *", "3.5", "equal", "0.400 / 0.400", "0.4000"),
        ("0", "1", "volume", "0.500 / 0.500", "0.5000"),
        ("2", "0", "equal", "2 cells failed", "n/a"),
    )
    assert markdown(table).splitlines()[:3] == [
        "| trial | w_target | tets | 5 / 15 | mean |",
        "| --- | --- | --- | --- | --- |",
        "| 1 * | 3.5 | equal | 0.400 / 0.400 | 0.4000 |",
    ]


@pytest.mark.parametrize(
    ("value", "text"), [(4.6e-6, "4.6e-6"), (0.046, "0.046"), (1.0, "1"), (1e5, "1.0e5"), (0.0, "0"), ("area", "area")]
)
def test_small_and_large_numbers_are_short(value: Any, text: str) -> None:
    assert scientific(value) == text


def test_pages_are_built_from_files_alone_and_twice_the_same(tmp_path: Path) -> None:
    facts = {
        "title": "Tuned settings",
        "description": "Trials.",
        "n_examples": [5, 15],
        "identities": ["a", "b", "c"],
        "vertices": 642,
        "draws": 1,
        "config": {"study": {"spaces": SPACES, "trials": 3, "test_expressions": 5}},
    }
    (tmp_path / "study.json").write_text(json.dumps(facts))
    trials().to_csv(tmp_path / "trials.csv", index=False)
    first = build_tuning_sheet(tmp_path).read_bytes()
    assert build_tuning_sheet(tmp_path).read_bytes() == first
    text = "".join(page.extract_text() for page in PdfReader(tmp_path / "tuning.pdf").pages)
    for words in ("6 ordered pairs of 3 identities", "642 vertices, 1 draw, 5 test", "2 cells failed", "delta"):
        assert words in text
    assert (tmp_path / "tables.md").read_text().count("| --- |") >= 4


def test_a_folder_without_a_finished_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"study\.json: this file is missing"):
        build_tuning_sheet(tmp_path)


def test_the_terminal_shows_choices_comparisons_and_failures(capsys: pytest.CaptureFixture[str]) -> None:
    print_tuning(trials(), Console(width=80))
    lines = capsys.readouterr().out.splitlines()
    said = {line.split()[0]: line.split()[1:] for line in lines if line.strip()}
    assert said["plbs"] == ["1", "0.200", "/", "0.100", "0.1500", "0.2500", "0.1500"]
    assert said["delta"] == ["0.700", "/", "0.700", "0.7000"]
    assert "lost, trial 0: 4 cells failed, so it has no error and cannot be chosen" in lines
    assert np.all([len(line) <= 80 for line in lines])
