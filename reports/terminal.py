"""The table that a run prints at its end."""

from __future__ import annotations

import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table

from reports.text import estimate

_WIDE = 100  # columns from which an estimate and its interval fit on one line


def print_summary(
    summary: pd.DataFrame, console: Console, metric: str = "vertex_l2_mean", region: str = "head"
) -> None:
    """Print methods x example counts from `summary.summarise`: mean [95 % interval] and cells without a result."""
    rows = summary[(summary["metric"] == metric) & (summary["region"] == region)]
    counts = sorted(rows["n_examples"].unique())
    failing = bool((rows["n_failed"] > 0).any())
    unit = " in mm" if metric.startswith("vertex_l2") else ""
    title = f"{metric}{unit}, region {region}: mean over pairs [95 % interval]"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("method", no_wrap=True)
    for count in counts:
        table.add_column(f"{count} examples", justify="right", no_wrap=True)
    if failing:
        table.add_column("failed", justify="right", no_wrap=True)
    for method in dict.fromkeys(rows["method"]):
        mine = rows[rows["method"] == method].set_index("n_examples")
        cells = [_cell(mine.loc[count]) if count in mine.index else "not run" for count in counts]
        if console.width < _WIDE:
            cells = [cell.replace(" \\[", "\n\\[") for cell in cells]
        failed = int(mine["n_failed"].sum())
        table.add_row(str(method), *cells, *([str(failed or "")] if failing else []))
    console.print(table)
    pairs = sorted(set(rows.loc[rows["n_pairs"] > 0, "n_pairs"].astype(int)))
    if pairs:
        console.print(f"over {' or '.join(map(str, pairs))} ordered pairs, on cells that all compared methods finished")


def _cell(row: pd.Series[float]) -> str:
    return estimate(row["mean"], row["ci_low"], row["ci_high"]).replace("[", "\\[")
