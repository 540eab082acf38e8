"""The table that a run prints at its end."""

from __future__ import annotations

import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table

from reports.text import estimate, number

_WIDE = 100  # columns from which an estimate and its interval fit on one line


def print_summary(
    summary: pd.DataFrame, console: Console, metric: str = "vertex_l2_mean", region: str = "head"
) -> None:
    """Print methods x example counts from `summary.summarise`: mean [95 % interval] and cells without a result.

    One table for each correspondence.
    """
    rows = summary[(summary["metric"] == metric) & (summary["region"] == region)]
    several = rows["correspondence"].nunique() > 1
    for correspondence, part in rows.groupby("correspondence", sort=False):
        _print_table(part, console, metric, region, f", {correspondence} examples" if several else "")


def _print_table(rows: pd.DataFrame, console: Console, metric: str, region: str, suffix: str) -> None:
    counts = sorted(rows["n_examples"].unique())
    failing = bool((rows["n_failed"] > 0).any())
    unit = " in mm" if metric.startswith("vertex_l2") else ""
    title = f"{metric}{unit}, region {region}{suffix}: mean over pairs [95 % interval]"
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


def print_solves(cells: pd.DataFrame, console: Console) -> None:
    """Print how many solves of each method did not converge or failed, where any did."""
    counted = cells.groupby("method", sort=False)[["solves", "solves_not_converged", "solves_failed"]].sum()
    for method, row in counted.iterrows():
        late, failed, total = row["solves_not_converged"], row["solves_failed"], row["solves"]
        if late or failed:
            console.print(f"{method}: of {total} solves {late} stopped at the iteration limit, {failed} failed")


def print_runtime(summary: pd.DataFrame, console: Console) -> None:
    """Print rates by form of the surface target from the summary of a study of the kind `runtime`."""
    first = summary.iloc[0]
    title = f"expressions per second, template {first['template']}: {first['tets']:,} tets, {first['threads']} threads"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in ("surface", "per s", "with lips", "set-up s", "iterations", "lips left mm"):
        table.add_column(name, justify="left" if name == "surface" else "right")
    for _, row in summary.iterrows():
        rates = f"{row['expressions_per_s']:.2f}", f"{row['expressions_per_s_collisions']:.2f}"
        rest = f"{row['setup_seconds']:.1f}", f"{row['iterations']:.1f}", f"{row['lip_depth_after_max']:.2f}"
        table.add_row(str(row["surface"]), *rates, *rest)
    console.print(table)
    console.print(
        f"anacondar as a whole: {first['anacondar_per_s']:.2f} per s, {first['anacondar_per_s_collisions']:.2f} with "
        f"lips; set-up {first['anacondar_setup_seconds']:.1f} s, heads fitted"
    )
    console.print(f"median over {first['expressions']} expressions; peak memory {first['peak_memory_mb']:,} MB")


def _cell(row: pd.Series[float]) -> str:
    return estimate(row["mean"], row["ci_low"], row["ci_high"]).replace("[", "\\[")


def print_collisions(summary: pd.DataFrame, console: Console) -> None:
    """Print depths before and after by pair from the summary of a study of the kind `collision`."""
    table = Table(
        title="lips that cross, largest depth in mm", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False
    )
    for name in ("pair", "expressions", "cross", "resolved", "before", "after"):
        table.add_column(name, justify="left" if name == "pair" else "right")
    for _, row in summary.iterrows():
        depths = f"{row['depth_before_max_mm']:.2f}", f"{row['depth_after_max_mm']:.2f}"
        table.add_row(*(str(row[name]) for name in ("pair", "expressions", "crossing", "resolved")), *depths)
    console.print(table)


def print_edits(summary: pd.DataFrame, console: Console) -> None:
    """Print what each edit moves from the summary of a study of the kind `artistic`."""
    table = Table(title="displacement by edits", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in ("edit", "mean mm", "largest mm", "share moved", "status"):
        table.add_column(name, justify="left" if name == "edit" else "right")
    for _, row in summary.iterrows():
        moved = f"{row['moved_mean_mm']:.3f}", f"{row['moved_max_mm']:.2f}", f"{row['moved_share']:.0%}"
        table.add_row(str(row["edit"]), *moved, str(row["status"]))
    console.print(table)


def print_tuning(trials: pd.DataFrame, console: Console) -> None:
    """Print the error of the chosen trial of each method beside the present one and the smallest.

    trials: of a study of the kind `tuning`, as in its ``trials.csv``.
    """
    errors = [name for name in trials.columns if name.startswith("error_")]
    counts = " / ".join(name.removeprefix("error_") for name in errors)
    title = f"error in mm with {counts} examples; mean over them. Trial 0 is as it is now"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for name in ("method", "trial", "error", "mean", "present", "best"):
        table.add_column(name, justify="left" if name == "method" else "right", no_wrap=True)
    for method, mine in trials.groupby("method", sort=False):
        tuned, taken = mine["trial"].notna().all(), mine[mine["chosen"]]
        if tuned and taken.empty:
            table.add_row(str(method), "none", "no result")
            continue
        row = (taken if tuned else mine).iloc[0]
        shown = " / ".join(number(row[name]) for name in errors), number(row["error"], 4)
        if tuned:
            present = mine.loc[mine["trial"] == 0, "error"].iloc[0]
            table.add_row(str(method), str(row["trial"]), *shown, number(present, 4), number(mine["error"].min(), 4))
        else:
            table.add_row(str(method), "", *shown)
    console.print(table)
    for _, row in trials[trials["n_failed"] > 0].iterrows():
        said = "" if pd.isna(row["trial"]) else f", trial {row['trial']}"
        console.print(f"{row['method']}{said}: {row['n_failed']} cells failed, so it has no error and cannot be chosen")
