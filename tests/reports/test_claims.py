"""Published claims: every rule decides both ways, and abstains where records cannot decide."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from reports.claims import CLAIMS, Claim, Judged, Status, judge, read_claims
from reports.load import StudyResults, load
from retarget.check import InvalidInput
from tests.reports.example_study import write_example_study

SMALLER = Claim("1", "a beats b", "smaller", "plbs", "lbs", counts=(5,))
FADES = Claim("1", "the advantage fades", "fades", "plbs", "lbs", counts=(5, 30))
ALIKE = Claim("1", "a is as b", "alike", "plbs", "lbs", counts=(5,), margin=0.2)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return load([write_example_study(tmp_path_factory.mktemp("claims"), identities=7, draws=1, failures=False)])[0]


def _with(study: StudyResults, factors: dict[tuple[str, int], float], identities: int = 7) -> StudyResults:
    """lbs and plbs with errors of a small spread about a factor for each (method, count)."""
    m = study.metrics[study.metrics["method"].isin(["lbs", "plbs"])].copy()
    people = sorted(m["source"].unique())[:identities]
    m = m[m["source"].isin(people) & m["target"].isin(people)]
    factor = [factors.get((str(a), int(n)), 1.0) for a, n in zip(m["method"], m["n_examples"], strict=True)]
    m["value"] = np.array(factor) * np.exp(0.02 * np.random.default_rng(0).normal(size=len(m)))
    return StudyResults(study.folder, study.facts, m, study.summary, study.cells)


def _one(claim: Claim, study: StudyResults) -> Judged:
    return judge([claim], {"study": study})[0]


@pytest.mark.parametrize(
    ("claim", "factors", "status", "words"),
    [
        (SMALLER, {("plbs", 5): 0.5}, Status.REPRODUCED, "All analyses agree (42 pairs of 7 people"),
        (SMALLER, {("plbs", 5): 2.0}, Status.NOT_REPRODUCED, "on the opposite"),
        (SMALLER, {}, Status.NOT_REPRODUCED, "No difference"),
        (FADES, {("plbs", 5): 0.5, ("plbs", 30): 0.9}, Status.REPRODUCED, "All analyses agree"),
        (FADES, {("plbs", 5): 0.9, ("plbs", 30): 0.5}, Status.NOT_REPRODUCED, "on the opposite"),
        (ALIKE, {("plbs", 5): 1.1}, Status.REPRODUCED, "The interval lies inside 0.83 to 1.20"),
        (ALIKE, {("plbs", 5): 1.2}, Status.INCONCLUSIVE, "The interval overlaps a bound of 0.83 to 1.20"),
        (ALIKE, {("plbs", 5): 1 / 1.2}, Status.INCONCLUSIVE, "overlaps a bound"),
        (ALIKE, {("plbs", 5): 1.5}, Status.NOT_REPRODUCED, "lies outside"),
        (ALIKE, {("plbs", 5): 0.5}, Status.NOT_REPRODUCED, "lies outside"),
    ],
)
def test_a_rule_decides_both_ways(
    study: StudyResults, claim: Claim, factors: dict[tuple[str, int], float], status: Status, words: str
) -> None:
    judged = _one(claim, _with(study, factors))
    assert judged.status == status
    assert words in judged.verdicts[0].sentence


def test_the_value_is_the_ratio_of_the_two_methods(study: StudyResults) -> None:
    assert _one(SMALLER, _with(study, {("plbs", 5): 0.5})).verdicts[0].value.startswith("0.50 [0.")
    fades = _one(FADES, _with(study, {("plbs", 5): 0.5, ("plbs", 30): 0.8}))
    assert fades.verdicts[0].value.startswith("1.60 [1.")


@pytest.mark.parametrize("claim", [SMALLER, FADES, ALIKE])
def test_few_people_and_missing_rows_are_not_testable(study: StudyResults, claim: Claim) -> None:
    few = _one(claim, _with(study, {("plbs", 5): 0.5}, identities=5))
    assert few.status == Status.NOT_TESTABLE
    assert "at least 6 people; here 20 pairs of 5 people" in few.verdicts[0].sentence
    assert few.verdicts[0].value
    some = _with(study, {})
    alone = StudyResults(
        some.folder, some.facts, some.metrics[some.metrics["method"] == "plbs"], some.summary, some.cells
    )
    assert _one(claim, alone).status == Status.NOT_TESTABLE
    pair = _with(study, {}, identities=2)
    assert _one(claim, pair).status == Status.NOT_TESTABLE


def test_values_of_zero_have_no_ratio(study: StudyResults) -> None:
    zero = _with(study, {("plbs", 5): 0.0})
    assert "no ratio" in _one(SMALLER, zero).verdicts[0].sentence


def test_one_study_that_does_not_find_it_is_enough(study: StudyResults) -> None:
    yes, no, few = _with(study, {("plbs", 5): 0.5}), _with(study, {}), _with(study, {}, identities=4)
    assert judge([SMALLER], {"a": yes, "b": few})[0].status == Status.REPRODUCED
    assert judge([SMALLER], {"a": yes, "b": no})[0].status == Status.NOT_REPRODUCED


def test_what_one_study_leaves_open_is_inconclusive_unless_another_refutes_it(study: StudyResults) -> None:
    alike, open_, other = (_with(study, {("plbs", 5): factor}) for factor in (1.0, 1.2, 1.5))
    assert judge([ALIKE], {"a": alike, "b": open_})[0].status == Status.INCONCLUSIVE
    assert judge([ALIKE], {"a": alike, "b": open_, "c": other})[0].status == Status.NOT_REPRODUCED


def test_the_family_of_a_corrected_p_is_named(study: StudyResults) -> None:
    """Three claims of a difference, of which one is of methods that no study has, and one of likeness."""
    found = judge([SMALLER, FADES, replace(SMALLER, other="gone"), ALIKE], {"study": _with(study, {("plbs", 5): 0.5})})
    verdict = found[0].verdicts[0]
    assert "Holm over the 3 claims of a difference" in verdict.sentence
    assert verdict.brief.startswith("agree, p < 0.0001")


@pytest.mark.parametrize(
    ("rule", "row", "status"),
    [
        ("at_least", {"kind": "a", "v": 10.0, "size": "paper"}, Status.REPRODUCED),
        ("at_least", {"kind": "a", "v": 9.9, "size": "paper"}, Status.NOT_REPRODUCED),
        ("at_most", {"kind": "a", "v": 10.0, "size": "paper"}, Status.REPRODUCED),
        ("at_most", {"kind": "a", "v": 10.1, "size": "paper"}, Status.NOT_REPRODUCED),
        ("at_most", {"kind": "a", "v": 1.0, "size": "coarse"}, Status.NOT_TESTABLE),
        ("at_most", {"kind": "b", "v": 1.0, "size": "paper"}, Status.NOT_TESTABLE),
        ("at_most", {"kind": "a", "v": np.nan, "size": "paper"}, Status.NOT_TESTABLE),
    ],
)
def test_limits_of_tables(rule: str, row: dict[str, object], status: Status) -> None:
    claim = Claim(
        "1", "fast", rule, of="runtime", column="v", where={"kind": "a"}, requires={"size": "paper"}, limit=10
    )
    assert judge([claim], {}, {"runtime": {"r": pd.DataFrame([row])}})[0].status == status


def test_what_people_judge_is_never_decided(study: StudyResults) -> None:
    assert _one(Claim("4.3", "people prefer it", "people"), _with(study, {})).status == Status.NOT_TESTABLE


def test_the_file_of_claims_is_read_and_others_are_refused(tmp_path: Path) -> None:
    claims = read_claims()
    assert len(claims) == 49
    assert {claim.rule for claim in claims} == {"smaller", "fades", "alike", "at_least", "at_most", "people"}
    path = tmp_path / "claims.yaml"
    for text, words in (
        ("- {section: a, says: b, rule: smalle}", "smaller"),
        ("- {section: a, rule: people}", "says"),
        ("- {section: a, says: b, rule: people, methods: x}", "method"),
        ("- {section: a, says: b, rule: fades, method: x, other: y, counts: [5]}", "two counts"),
        ("- {section: a, says: b, rule: smaller, method: x, counts: [5]}", "needs method, other"),
        ("- {section: a, says: b, rule: at_least, of: runtime}", "needs of, column"),
    ):
        path.write_text(text)
        with pytest.raises(InvalidInput, match=words):
            read_claims(path)
    assert CLAIMS.exists()
