"""Cells of one study as arrays: one value per method and cell, on the cells where all compared methods finished."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
import pandas as pd

from reports.statistics import Clusters, Resamples
from retarget.check import InvalidInput
from retarget.types import FloatArray

CONDITIONS = ("dataset", "truth", "weights", "noise_mm", "correspondence")
METRIC_COLUMNS = (
    "method", "source", "target", "n_examples", "draw", "expression", "metric", "region", "value", "unit",
    *CONDITIONS, "status",
)  # fmt: skip
FINISHED = ("ok", "not_converged")
_CELL = ["source", "target", "draw"]


def check_metrics(name: str, metrics: pd.DataFrame) -> None:
    """Raises InvalidInput unless the table has the tidy columns that a study writes."""
    if missing := [column for column in METRIC_COLUMNS if column not in metrics.columns]:
        raise InvalidInput(
            f"{name}: expected the columns {', '.join(METRIC_COLUMNS)}; missing: {', '.join(missing)}. "
            "The table was not written by this version; run the study again."
        )


@dataclass(frozen=True)
class Block:
    """Everything measured under one set of conditions at one number of examples.

    A method that finished no cell at all is not compared; the others are compared where all of them finished, so
    that every mean covers the same cells.
    """

    conditions: tuple[Any, ...]  # values of CONDITIONS
    n_examples: int
    rows: pd.DataFrame  # METRIC_COLUMNS, of this block alone
    methods: tuple[str, ...]  # in the order of the study's table
    finished: pd.DataFrame  # bool, index (source, target, draw), one column per method

    @cached_property
    def compared(self) -> tuple[str, ...]:
        return tuple(method for method in self.methods if self.finished[method].any())

    @cached_property
    def common(self) -> pd.MultiIndex:
        """The cells (source, target, draw) where all compared methods finished."""
        shared = self.finished[list(self.compared)].all(axis=1) & bool(self.compared)
        return pd.MultiIndex.from_tuples(list(self.finished.index[shared]), names=_CELL)

    def failures(self, method: str) -> int:
        """The number of cells that the method failed or did not serve."""
        return int(self._failures[method])

    @cached_property
    def _failures(self) -> pd.Series[int]:
        return (~self.finished).sum()

    @cached_property
    def measured(self) -> tuple[tuple[str, str], ...]:
        """(metric, region) in the order of the rows."""
        pairs = self.rows[["metric", "region"]].drop_duplicates()
        return tuple(zip(pairs["metric"], pairs["region"], strict=True))

    @cached_property
    def clusters(self) -> Clusters:
        return Clusters.of(self.common.get_level_values(0).tolist(), self.common.get_level_values(1).tolist())

    def resamples(self, seed: int) -> Resamples:
        return Resamples.of(self.clusters, seed)

    @cached_property
    def means(self) -> pd.DataFrame:
        """Means over expressions; index the common cells, columns (method, metric, region)."""
        by_cell = self.rows.groupby([*_CELL, "method", "metric", "region"], observed=True, sort=False)["value"].mean()
        return by_cell.unstack(["method", "metric", "region"]).reindex(self.common)

    def cells(self, method: str, metric: str, region: str) -> FloatArray:
        """(c,) mean over expressions per common cell; NaN where it was not measured."""
        key = (method, metric, region)
        return self.means[key].to_numpy(dtype=np.float64) if key in self.means else np.full(len(self.common), np.nan)

    def pooled(self, method: str, metric: str, region: str) -> FloatArray:
        """(m,) values of single expressions on the common cells, in the same order for every method."""
        r = self.rows
        chosen = r[(r["method"] == method) & (r["metric"] == metric) & (r["region"] == region)]
        shared = pd.MultiIndex.from_frame(chosen[_CELL]).isin(self.common)
        return chosen[shared].sort_values([*_CELL, "expression"])["value"].to_numpy(dtype=np.float64)


def blocks(metrics: pd.DataFrame, order: Sequence[str] | None = None) -> Iterator[Block]:
    """Split the tidy table by conditions and number of examples; `order` names methods first to last."""
    keys = [*CONDITIONS, "n_examples"]
    methods = list(order) if order is not None else list(metrics["method"].unique())
    for key, rows in metrics.groupby(keys, observed=True, sort=True, dropna=False):
        *conditions, n_examples = cast(tuple[Any, ...], key)
        present = set(rows["method"].unique())
        statuses = rows.drop_duplicates([*_CELL, "method"])
        finished = (
            statuses.assign(done=statuses["status"].isin(FINISHED))
            .pivot(index=_CELL, columns="method", values="done")
            .astype("boolean")
            .fillna(False)
            .astype(bool)
            .sort_index()
        )
        yield Block(tuple(conditions), int(n_examples), rows, tuple(m for m in methods if m in present), finished)
