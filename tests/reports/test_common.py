"""What is said once for all studies, and what is said of each."""

from __future__ import annotations

from dataclasses import replace

import pytest

from reports.common import common_times, merged_facts, merged_methods, shared_sentences
from reports.load import StudyResults, load
from reports.tables import time_rows
from tests.reports.example_study import write_example_study


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return load([write_example_study(tmp_path_factory.mktemp("study"), identities=3, draws=1, failures=False)])[0]


def test_sentences_that_all_say() -> None:
    assert shared_sentences([["a", "b", "c"], ["c", "b", "d"]]) == ["b", "c"]
    assert shared_sentences([["a"]]) == []


def test_facts_without_a_name_where_all_agree() -> None:
    named = [("one", [("seed", "0"), ("truth", "x")]), ("two", [("seed", "0"), ("truth", "y")])]
    assert merged_facts([*named, ("three", [("seed", "0"), ("truth", "x")])]) == [
        ("seed", [("", "0")]),
        ("truth", [("one, three", "x"), ("two", "y")]),
    ]


def test_a_method_has_a_row_for_each_of_its_settings(study: StudyResults) -> None:
    methods = [dict(method) for method in study.facts["methods"]]
    changed = next(method for method in methods if method["name"] == "plbs")
    changed["settings"] = {"regularisation": 7}
    other = replace(study, facts={**study.facts, "methods": methods})
    rows = merged_methods([("one", study), ("two", study), ("three", other)])
    assert len(rows) == len(study.methods) + 1
    assert [row["studies"] for row in rows if row["label"] == "plbs"] == ["one, two", "three"]
    assert {row["studies"] for row in rows if row["label"] != "plbs"} == {""}


def test_times_of_conditions_together(study: StudyResults) -> None:
    rows = common_times([study, study])
    assert rows is not None
    assert [row["label"] for row in rows] == [row["label"] for row in time_rows(study)]
    medians = [row["prepare"]["median"] for row in rows]
    assert medians == [row["prepare"]["median"] for row in time_rows(study)]
    slower = replace(study, cells=study.cells.assign(prepare_seconds=study.cells["prepare_seconds"] * 1e3))
    assert common_times([study, slower, slower]) != rows  # the times of each condition count
    assert common_times([study, replace(study, facts={**study.facts, "n_examples": [5]})]) is None
