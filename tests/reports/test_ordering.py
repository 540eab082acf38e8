"""The order of methods under several conditions: ranks and agreement, counted by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from reports.load import StudyResults, load
from reports.ordering import Ordering, overview
from reports.ordering_plot import ordering_plot
from tests.reports.example_study import write_example_study

METHODS = ("delta", "sumner_popovic", "lbs", "plbs", "plbs_residual")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return load([write_example_study(tmp_path_factory.mktemp("study"), identities=3, draws=1, failures=False)])[0]


def under(study: StudyResults, name: str, means: dict[str, float], count: int = 5) -> StudyResults:
    """The study with one example count and these means."""
    summary = study.summary[(study.summary["n_examples"] == count) & study.summary["method"].isin(means)].copy()
    summary["mean"] = summary["method"].map(means)
    facts = {**study.facts, "n_examples": [count]}
    return replace(study, facts=facts, summary=summary, differs=f"dataset.truth={name}")


def test_ranks_and_agreement_as_counted_by_hand(study: StudyResults) -> None:
    first = under(study, "one", dict(zip(METHODS, (1.0, 2.0, 3.0, 4.0, 5.0), strict=True)) | {"neutral": 0.1})
    second = under(study, "two", dict(zip(METHODS, (2.0, 1.0, 3.0, 5.0, 4.0), strict=True)))
    ordering = Ordering([first, second])
    assert ordering.conditions == ("truth one", "truth two")
    np.testing.assert_array_equal(ordering.ranks("delta", 5), [1, 2])
    np.testing.assert_array_equal(ordering.ranks("plbs", 5), [4, 5])
    assert np.isnan(ordering.ranks("neutral", 5)).all()  # a reference row has no rank, and takes none
    assert ordering.tau(0, 1, 5) == pytest.approx((8 - 2) / 10)  # 8 of 10 pairs in the same order, 2 in the other
    assert ordering.methods[-1].kind == "reference"
    said = overview(ordering)["findings"]
    assert len(said) == 1
    assert "that of delta with truth one; sumner popovic with truth two." in said[0]
    assert "Kendall's tau is 0.60" in said[0]


def test_the_same_order_is_called_the_same(study: StudyResults) -> None:
    means = dict(zip(METHODS, (5.0, 4.0, 3.0, 2.0, 1.0), strict=True))
    twice = {name: 2 * value for name, value in means.items()}
    ordering = Ordering([under(study, "one", means), under(study, "two", twice), under(study, "three", twice)])
    assert overview(ordering)["findings"] == [
        "5 examples: the smallest mean is that of plbs residual under every condition. "
        "The order of methods is the same under all conditions."
    ]
    assert [method.name for method in ordering.methods][:5] == list(reversed(METHODS))


def test_a_method_without_a_result_has_no_rank_and_enters_no_agreement(study: StudyResults) -> None:
    first = under(study, "one", dict(zip(METHODS, (1.0, 2.0, 3.0, 4.0, 5.0), strict=True)))
    second = under(study, "two", dict(zip(METHODS, (np.nan, 2.0, 3.0, 4.0, 5.0), strict=True)))
    ordering = Ordering([first, second])
    np.testing.assert_array_equal(ordering.ranks("delta", 5), [1, np.nan])
    np.testing.assert_array_equal(ordering.ranks("lbs", 5), [3, 2])
    assert ordering.tau(0, 1, 5) == pytest.approx(1)
    rows = overview(ordering)["parts"][0]["rows"]
    assert next(row for row in rows if row["label"] == "delta")["cells"][1]["mean"] == "no result"


def test_no_statement_is_made_of_a_truth_that_a_method_owns(study: StudyResults, tmp_path: Path) -> None:
    means = dict(zip(METHODS, (1.0, 2.0, 3.0, 4.0, 5.0), strict=True))
    owned = under(study, "additive", means | {"delta": 6.0, "plbs": 1e-15})
    owned = replace(owned, facts={**owned.facts, "dataset": {**owned.facts["dataset"], "truth": "additive"}})
    ordering = Ordering([owned, under(study, "one", means), under(study, "two", means)])
    assert ordering.conditions == ("truth additive (sanity)", "truth one", "truth two")
    assert overview(ordering)["findings"] == [
        "5 examples: the smallest mean is that of delta under every condition but truth additive, which is a check, "
        "not evidence. The order of methods is the same under these conditions."
    ]
    swapped = under(study, "two", means | {"plbs": 0.5})
    assert (
        "plbs with truth two. Left out: truth additive, which is a check, not evidence. The orders differ"
        in (overview(Ordering([under(study, "one", means), swapped, owned]))["findings"][0])
    )
    ordering_plot(ordering, tmp_path / "plot.svg")
    assert "<!-- exact -->" in (tmp_path / "plot.svg").read_text()  # rounding takes no decades of the axis


def test_what_is_exact_takes_no_part_in_the_axis(
    study: StudyResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an interval of 1e-15 mm about one exact mean the axis still begins at the smallest other value."""
    means = dict(zip(METHODS, (1.0, 2.0, 3.0, 4.0, 5.0), strict=True))
    studies = [under(study, "one", means | {"plbs": 1e-15}), under(study, "two", means)]
    for one in studies:
        one.summary[["ci_low", "ci_high"]] = np.outer(one.summary["mean"], (0.9, 1.1))
    limits: list[tuple[float, float]] = []
    monkeypatch.setattr("reports.figures.log_ticks", lambda axes, which, low, high: limits.append((low, high)))
    ordering_plot(Ordering(studies), tmp_path / "plot.svg")
    assert limits == [(pytest.approx(0.9), pytest.approx(5.5))]


def test_two_methods_have_no_agreement(study: StudyResults) -> None:
    two = [under(study, name, {"plbs": 1.0, "lbs": 2.0}) for name in ("one", "two")]
    ordering = Ordering(two)
    assert np.isnan(ordering.tau(0, 1, 5))
    assert "Orders of fewer than 3 methods are not compared." in overview(ordering)["findings"][0]


def test_studies_that_differ_in_more_than_data_keep_their_whole_names(study: StudyResults) -> None:
    other = replace(study, differs="dataset.noise_mm=0.3, study.seed=1")
    assert Ordering([other, other]).conditions == ("dataset.noise_mm=0.3, study.seed=1",) * 2


def test_the_plot_shows_every_condition_and_is_repeated(study: StudyResults, tmp_path: Path) -> None:
    means = pd.Series(dict(zip(METHODS, (1.0, 2.0, 3.0, 4.0, 5.0), strict=True)))
    ordering = Ordering([under(study, name, dict(factor * means)) for name, factor in (("one", 1.0), ("two", 2.0))])
    for name in ("a.svg", "b.svg"):
        ordering_plot(ordering, tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    drawn = (tmp_path / "a.svg").read_text()
    assert "#0072b2" in drawn  # the first condition
    assert "#e69f00" in drawn  # the second
