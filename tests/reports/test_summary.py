"""The summary table by hand, and on a study with failed and unsupported cells."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.cells import METRIC_COLUMNS
from reports.statistics import holm, wilcoxon
from reports.summary import SUMMARY_COLUMNS, paired_tests, region_tests, summarise
from retarget.check import InvalidInput

PEOPLE = ("a", "b", "c", "d")


def _metrics(values: dict[str, float], failed: tuple[Any, ...] = (), counts: tuple[int, ...] = (5,)) -> pd.DataFrame:
    """value = method's value x (1 + pair number + 0.1 draw + 0.01 expression); failed: (method, pair, count, draw)."""
    rows = []
    for (method, value), (i, (source, target)), count, draw, expression in itertools.product(
        values.items(), enumerate(itertools.permutations(PEOPLE, 2)), counts, range(2), range(2)
    ):
        ok = (method, i, count, draw) not in failed
        size = value * (1 + i + 0.1 * draw + 0.01 * expression)
        rows.append(
            (method, source, target, count, draw, f"e{expression}", "vertex_l2_mean", "head", size if ok else np.nan,
             "mm", "data", "linear", "sparse", 0.0, "given", "ok" if ok else "failed")
        )  # fmt: skip
    return pd.DataFrame(rows, columns=list(METRIC_COLUMNS))


def test_columns_means_and_ratios_by_hand() -> None:
    table = summarise(_metrics({"plbs": 1.0, "lbs": 2.0}), "plbs", ["lbs"])
    assert tuple(table.columns) == SUMMARY_COLUMNS
    rows: Any = table.set_index("method")
    expected = np.mean([1 + i + 0.05 + 0.005 for i in range(12)])
    assert rows.loc["plbs", "mean"] == pytest.approx(expected)
    assert rows.loc["lbs", "median"] == pytest.approx(2 * expected)  # symmetric values
    assert rows.loc["lbs", "ratio"] == pytest.approx(2.0)
    assert rows.loc["lbs", "win_rate"] == 0.0
    assert rows.loc["lbs", "n_pairs"] == 12
    assert rows.loc["lbs", "ci_low"] < 2 * expected < rows.loc["lbs", "ci_high"]
    assert rows.loc["lbs", "p_holm"] == pytest.approx(2 / 2**12)
    assert np.isnan(rows.loc["plbs", "ratio"])
    assert np.isnan(rows.loc["plbs", "p_holm"])


def test_a_mean_covers_only_cells_that_all_finished() -> None:
    failed = (("lbs", 11, 5, 0), ("lbs", 11, 5, 1), ("lbs", 10, 5, 1))
    rows: Any = summarise(_metrics({"plbs": 1.0, "lbs": 2.0}, failed), "plbs", ["lbs"]).set_index("method")
    pairs = [1 + i + 0.055 for i in range(10)] + [11 + 0.005]  # pair 10 keeps draw 0 only
    assert rows.loc["plbs", "mean"] == pytest.approx(np.mean(pairs))
    assert list(rows["n_pairs"]) == [11, 11]
    assert (rows.loc["lbs", "n_failed"], rows.loc["plbs", "n_failed"]) == (3, 0)


def test_a_method_without_any_result_leaves_the_others_alone() -> None:
    failed = tuple(("lbs", i, 5, draw) for i in range(12) for draw in range(2))
    rows: Any = summarise(_metrics({"plbs": 1.0, "lbs": 2.0, "delta": 3.0}, failed), "plbs", ["lbs", "delta"])
    rows = rows.set_index("method")
    assert np.isnan(rows.loc["lbs", "mean"])
    assert rows.loc["lbs", "n_failed"] == 24
    assert rows.loc["lbs", "n_pairs"] == 0
    assert rows.loc["delta", "n_pairs"] == 12
    assert rows.loc["delta", "p_holm"] < 0.05


def test_holm_covers_methods_and_counts_but_not_the_reference() -> None:
    metrics = _metrics({"plbs": 1.0, "lbs": 1.3, "delta": 0.9, "neutral": 5.0}, counts=(5, 15))
    rng = np.random.default_rng(0)
    metrics["value"] *= np.exp(0.5 * rng.normal(size=len(metrics)))
    tests: Any = paired_tests(metrics, "plbs", ["lbs", "delta", "plbs"])
    assert set(tests["method"]) == {"lbs", "delta"}
    assert len(tests) == 4
    np.testing.assert_allclose(tests["p_holm"], holm(tests["p"]))
    first: Any = metrics[(metrics["n_examples"] == 5)].groupby(["method", "source", "target"])["value"].mean()
    expected = wilcoxon(np.log(first["lbs"]).to_numpy(), np.log(first["plbs"]).to_numpy())
    assert tests.set_index(["method", "n_examples"]).loc[("lbs", 5), "p"] == pytest.approx(expected)


def test_a_member_that_was_not_run_still_counts() -> None:
    metrics = _metrics({"plbs": 1.0, "lbs": 1.3}, counts=(5, 15))
    alone, among = (paired_tests(metrics, "plbs", family) for family in (["lbs"], ["lbs", "delta", "other"]))
    assert list(among["method"]) == ["lbs", "lbs"]
    np.testing.assert_allclose(among["p_holm"], holm(alone["p"], 6))
    assert (among["p_holm"] == 3 * alone["p_holm"]).all()


def test_region_tests_are_those_of_the_full_analysis() -> None:
    rng = np.random.default_rng(2)
    metrics = _metrics({"plbs": 1.0, "lbs": 1.1, "delta": 0.9}, counts=(5, 15))
    metrics = pd.concat([metrics, metrics.assign(region="lips")], ignore_index=True)
    metrics["value"] *= np.exp(0.5 * rng.normal(size=len(metrics)))
    methods = ["plbs", "lbs", "delta"]
    found = region_tests(metrics, "plbs", methods, "vertex_l2_mean")
    keys = ["method", "n_examples", "region"]
    full = [
        paired_tests(metrics, "plbs", methods, region=region)[["method", "n_examples", "p"]].assign(region=region)
        for region in ("head", "lips")
    ]
    one, two = (table.set_index(keys)["p"].sort_index() for table in (found, pd.concat(full)))
    assert len(one) == 8
    pd.testing.assert_series_equal(one, two)


def test_rows_do_not_depend_on_the_order_of_the_input() -> None:
    metrics = _metrics({"plbs": 1.0, "lbs": 2.0}, (("lbs", 3, 5, 0),))
    shuffled = metrics.sample(frac=1.0, random_state=3)
    keys = ["method", "n_examples"]
    one, two = (summarise(m, "plbs", ["lbs"]).sort_values(keys, ignore_index=True) for m in (metrics, shuffled))
    pd.testing.assert_frame_equal(one, two, check_exact=False, rtol=1e-12)


def test_signed_values_have_no_ratio() -> None:
    metrics = _metrics({"plbs": 1.0, "lbs": -2.0})
    row: Any = summarise(metrics, "plbs", []).set_index("method").loc["lbs"]
    assert np.isnan(row["ratio"])
    assert np.isnan(row["win_rate"])
    assert row["mean"] < 0


def test_a_missing_column_is_named() -> None:
    with pytest.raises(InvalidInput, match="missing: region"):
        summarise(_metrics({"plbs": 1.0}).drop(columns="region"), "plbs", [])
