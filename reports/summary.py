"""The summary table of a study, and the tests of its primary family."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from reports.cells import CONDITIONS, Block, blocks, check_metrics
from reports.statistics import Resamples, compare, geometric_mean_ratio, holm, interval, pair_p, win_rate

SUMMARY_COLUMNS = (
    "method", *CONDITIONS, "n_examples", "metric", "region", "mean", "median", "ci_low", "ci_high", "n_pairs",
    "n_failed", "ratio", "p_holm", "win_rate",
)  # fmt: skip


def summarise(
    metrics: pd.DataFrame,
    reference: str,
    primary_family: Sequence[str],
    primary_metric: str = "vertex_l2_mean",
    primary_region: str = "head",
    seed: int = 0,
) -> pd.DataFrame:
    """One row per method, conditions, example count, metric and region; columns SUMMARY_COLUMNS.

    mean, median   over one value per (source, target) pair: its mean over draws and expressions
    ci_low, ci_high  nominal 95 % interval of the mean, resampling sources, targets and draws; empty below 3 people
    n_pairs        pairs with a cell that all compared methods finished; nothing else enters a mean
    n_failed       cells that this method failed or did not serve
    ratio          geometric mean over pairs of method / reference, for positive values
    win_rate       share of pairs where the method's value is smaller, for metrics that are never negative
    p_holm         Wilcoxon signed-rank on the pairs' log ratios, Holm over the declared primary family (methods x
                   example counts), for the primary metric and region of its members; else empty, as below 4 people

    primary_family names methods, whether they were run or not, and no reference rows.

    Raises InvalidInput if the table lacks a column.
    """
    check_metrics("metrics", metrics)
    split = list(blocks(metrics))
    rows = [row for block in split for row in _summarise(block, reference, seed)]
    summary = pd.DataFrame(rows, columns=list(SUMMARY_COLUMNS))
    tests = _tests(split, reference, primary_family, primary_metric, primary_region, seed)
    keys = ["method", *CONDITIONS, "n_examples", "metric", "region"]
    corrected = tests.assign(metric=primary_metric, region=primary_region).set_index(keys)["p_holm"]
    summary["p_holm"] = corrected.reindex(pd.MultiIndex.from_frame(summary[keys])).to_numpy()
    return summary


def paired_tests(
    metrics: pd.DataFrame,
    reference: str,
    methods: Sequence[str],
    metric: str = "vertex_l2_mean",
    region: str = "head",
    seed: int = 0,
) -> pd.DataFrame:
    """Each method against the reference, per conditions and example count.

    Columns: method, CONDITIONS, n_examples, those of `statistics.PairedComparison`, and p_holm, corrected over all
    methods x the example counts of one set of conditions, whether they were run or not. A method without any result
    has n_pairs 0 and no values; one that was not run has no row.
    """
    return _tests(list(blocks(metrics)), reference, methods, metric, region, seed)


def _tests(
    split: Sequence[Block], reference: str, methods: Sequence[str], metric: str, region: str, seed: int
) -> pd.DataFrame:
    family = tuple(name for name in dict.fromkeys(methods) if name != reference)
    found = []
    for block in split:
        if reference not in block.compared:
            continue
        resamples = block.resamples(seed)
        for method in family:
            if method not in block.methods:
                continue
            if method not in block.compared:
                found.append({**_labels(block, method), "n_pairs": 0})
                continue
            comparison = compare(
                block.cells(method, metric, region),
                block.cells(reference, metric, region),
                resamples,
                block.pooled(method, metric, region),
                block.pooled(reference, metric, region),
            )
            found.append({**_labels(block, method), **asdict(comparison)})
    columns = ["method", *CONDITIONS, "n_examples", "n_pairs", "ratio", "ratio_low", "ratio_high", "win_rate",
               "effect", "p", "p_sources", "p_targets", "p_naive"]  # fmt: skip
    table = pd.DataFrame(found, columns=columns)
    table["p_holm"] = np.nan
    counts = len({block.n_examples for block in split})
    for _, tests in table.groupby(list(CONDITIONS), sort=False, dropna=False):
        table.loc[tests.index, "p_holm"] = holm(tests["p"], len(family) * counts)
    return table


def region_tests(metrics: pd.DataFrame, reference: str, methods: Sequence[str], metric: str) -> pd.DataFrame:
    """Each method against the reference in each region: columns method, n_examples, region, and p on pairs, raw."""
    found = [
        (
            method,
            block.n_examples,
            region,
            pair_p(block.cells(method, metric, region), block.cells(reference, metric, region), block.clusters),
        )
        for block in blocks(metrics[metrics["metric"] == metric])
        if reference in block.compared
        for method in methods
        if method in block.compared and method != reference
        for region in block.rows["region"].unique()
    ]
    return pd.DataFrame(found, columns=["method", "n_examples", "region", "p"])


def _summarise(block: Block, reference: str, seed: int) -> Iterator[dict[str, Any]]:
    columns = [(method, metric, region) for method in block.compared for metric, region in block.measured]
    values = block.means.reindex(columns=pd.MultiIndex.from_tuples(columns)) if columns else None
    cells = np.empty((len(block.common), 0)) if values is None else values.to_numpy(dtype=np.float64)
    pairs = block.clusters.pair_means(cells)
    low, high = interval(Resamples.of(block.clusters, seed).means(cells))
    at = {column: i for i, column in enumerate(columns)}
    for method in block.methods:
        for metric, region in block.measured:
            row = {**_labels(block, method), "metric": metric, "region": region, "n_failed": block.failures(method)}
            i, j = at.get((method, metric, region)), at.get((reference, metric, region))
            if i is None or not len(pairs):
                yield row | {"n_pairs": 0}
                continue
            row |= {"n_pairs": block.clusters.count, "mean": pairs[:, i].mean(), "median": np.median(pairs[:, i])}
            row |= {"ci_low": low[i], "ci_high": high[i]}
            if j is not None and method != reference and (pairs[:, [i, j]] >= 0).all():
                row["ratio"] = geometric_mean_ratio(pairs[:, i], pairs[:, j])
                row["win_rate"] = win_rate(pairs[:, i], pairs[:, j])
            yield row


def _labels(block: Block, method: str) -> dict[str, Any]:
    return {"method": method, **dict(zip(CONDITIONS, block.conditions, strict=True)), "n_examples": block.n_examples}
