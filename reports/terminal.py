"""The table that a run prints at its end."""

from __future__ import annotations

import pandas as pd
from rich.console import Console
from rich.table import Table

from reports.text import estimate


def print_summary(
    summary: pd.DataFrame, console: Console, metric: str = "vertex_l2_mean", region: str = "head"
) -> None:
    """Print methods x example counts from `summary.summarise`: mean [95 % interval] and cells without an answer."""
    rows = summary[(summary["metric"] == metric) & (summary["region"] == region)]
    counts = sorted(rows["n_examples"].unique())
    table = Table(title=f"{metric}, {region}: mean over pairs [95 % interval]", title_justify="left")
    table.add_column("method", no_wrap=True)
    for count in counts:
        table.add_column(f"{count} examples", justify="right", no_wrap=True)
    table.add_column("cells without a result", justify="right")
    for method in dict.fromkeys(rows["method"]):
        mine = rows[rows["method"] == method].set_index("n_examples")
        failed = int(mine["n_failed"].sum())
        estimates = [
            estimate(mine.loc[count, "mean"], mine.loc[count, "ci_low"], mine.loc[count, "ci_high"])
            if count in mine.index
            else "not run"
            for count in counts
        ]
        table.add_row(str(method), *estimates, f"[bold red]{failed}[/]" if failed else "0")
    console.print(table)
    pairs = sorted(set(rows.loc[rows["n_pairs"] > 0, "n_pairs"].astype(int)))
    if pairs:
        console.print(f"over {' or '.join(map(str, pairs))} ordered pairs, on cells that all compared methods finished")
