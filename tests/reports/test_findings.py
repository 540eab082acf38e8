"""Statements of the title page: what is claimed, where, and in whole sentences."""

from __future__ import annotations

from dataclasses import replace

import pytest

from reports.findings import PER_COMPARISON, findings
from reports.load import StudyResults, load
from reports.summary import paired_tests
from tests.reports.example_study import FAMILY, write_example_study


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return load([write_example_study(tmp_path_factory.mktemp("study"), identities=7, draws=1, failures=False)])[0]


def under(study: StudyResults, truth: str) -> StudyResults:
    return replace(study, facts={**study.facts, "dataset": {**study.facts["dataset"], "truth": truth}})


def said(study: StudyResults) -> tuple[str, ...]:
    return findings(study, paired_tests(study.metrics, "plbs", FAMILY))


def test_a_truth_of_sanity_claims_no_difference(study: StudyResults) -> None:
    assert "Error larger than that of plbs" in " ".join(said(under(study, "nonlinear")))
    check = said(under(study, "additive"))
    assert "the smallest mean error is that of plbs residual" in check[0]
    assert "Error larger" not in " ".join(check)
    assert "claimed for" not in " ".join(check)
    assert PER_COMPARISON not in check
    assert "no difference is claimed from it" in " ".join(check)


def test_a_reference_without_a_result_is_named_in_a_whole_sentence(study: StudyResults) -> None:
    lost = study.summary.assign(mean=study.summary["mean"].where(study.summary["method"] != "plbs"))
    first = findings(replace(study, summary=lost), paired_tests(study.metrics, "plbs", FAMILY).iloc[:0])[0]
    assert first.endswith(" mm; the reference, plbs, has no result.")
    assert all(one.endswith(".") for one in said(study))
