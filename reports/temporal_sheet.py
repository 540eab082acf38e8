"""The pages of a study of the kind `temporal`: errors over time and a table, from its files alone."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from reports.colors import REFERENCE_ROW, method_color
from reports.figures import canvas
from reports.folders import results_folders
from reports.sheet import Picture, PictureRow, Pictures, Table, write_sheet
from reports.text import bounds, number
from retarget.check import InvalidInput

COLUMNS = 3
MEASURES = (  # metric, head of the column, digits
    ("relative_error", "error, % of motion", 1),
    ("acceleration_error", "acceleration error, %", 1),
    ("acceleration_excess", "excess", 3),
    ("noise_response", "noise response", 2),
)


def temporal_folders(folders: Sequence[Path]) -> tuple[Path, ...]:
    """Those with a finished study of this kind, among `reports.folders.results_folders`."""
    found = results_folders(folders)
    return tuple(sorted(path for path in found if all((path / n).exists() for n in ("times.csv", "study.json"))))


def build_temporal_sheet(folder: Path) -> Path:
    """Write ``temporal.pdf`` beside the study's files; returns its path.

    Raises InvalidInput for a folder without a finished study of this kind.
    """
    try:
        facts = json.loads((folder / "study.json").read_text(encoding="utf-8"))
        metrics, cells = (pd.read_parquet(folder / f"{name}.parquet") for name in ("metrics", "cells"))
        summary, identity, times = (pd.read_csv(folder / f"{name}.csv") for name in ("summary", "identity", "times"))
    except FileNotFoundError as error:
        raise InvalidInput(f"{error.filename}: this file is missing; run study=temporal until it ends.") from error
    region = facts["primary_region"]
    rows = metrics[(metrics["metric"] == "vertex_l2_mean") & (metrics["region"] == region)]
    kinds = {method["name"]: method["kind"] for method in facts["methods"]}
    with tempfile.TemporaryDirectory(prefix="sheet-") as name:
        work = Path(name)
        blocks: list[Pictures | Table] = []
        for count in facts["n_examples"]:
            file = f"over-time-{count}.svg"
            _over_time(rows[rows["n_examples"] == count], times, kinds, facts["reference"], work / file)
            row = PictureRow((Picture(file),), f"{count} examples")
            said = (
                f"Mean vertex error on the {region} in mm over time in s: mean over pairs (line) and their range "
                f"(band). Grey: the motion itself. Thin line: {facts['reference']}."
            )
            blocks += [Pictures(("",), (1.0,), (row,), said), _table(count, facts, kinds, summary, cells, identity)]
        write_sheet(folder / "temporal.pdf", facts["title"], _description(facts, times), blocks, work)
    return folder / "temporal.pdf"


def _description(facts: dict[str, Any], times: pd.DataFrame) -> str:
    data, study = facts["dataset"], facts["config"]["study"]
    rate = 1 / np.median(np.diff(times["seconds"]))
    return (
        f"{facts['description']} {len(times)} frames at {rate:g} per second of {study['recording'] or 'conversation'}, "
        f"{len(facts['identities'])} identities, truth {data['truth']}, {facts['vertices']:,} vertices."
    )


def _over_time(rows: pd.DataFrame, times: pd.DataFrame, kinds: dict[str, str], reference: str, path: Path) -> None:
    """One plot for each method, all with the same axes."""
    seconds = times.set_index("expression")["seconds"]
    curves: dict[str, pd.DataFrame] = {}
    for method, mine in rows.groupby(rows["method"].astype(str), sort=False):
        wide = mine.dropna(subset="value").pivot_table(
            index="expression", columns=["source", "target", "draw"], values="value"
        )
        curves[str(method)] = wide.reindex(seconds.index)
    shown = [method for method, table in curves.items() if method != "neutral" and table.size]
    highest = max((float(np.nanmax(curves[method].to_numpy())) for method in shown), default=1.0)
    lines = max(-(-len(shown) // COLUMNS), 1)
    with canvas(path, 174 / 25.4, 1.25 * lines + 0.3) as figure:
        grid = figure.subplots(
            lines, COLUMNS, sharex=True, sharey=True, squeeze=False,
            gridspec_kw={"left": 0.06, "right": 0.995, "top": 0.95, "bottom": 0.36 / (1.25 * lines + 0.3),
                         "hspace": 0.3, "wspace": 0.06},
        )  # fmt: skip
        for axes, method in zip(grid.flat, shown, strict=False):
            color = REFERENCE_ROW if kinds[method] == "reference" else method_color(shown.index(method))
            table = curves[method]
            if "neutral" in curves:
                axes.fill_between(seconds, 0, curves["neutral"].mean(axis=1), color="#ececec", lw=0)
            if reference in curves and method != reference:
                axes.plot(seconds, curves[reference].mean(axis=1), color="#222222", lw=0.5)
            axes.fill_between(seconds, table.min(axis=1), table.max(axis=1), color=color, alpha=0.25, lw=0)
            axes.plot(seconds, table.mean(axis=1), color=color, lw=1.0)
            axes.set_title(method, fontsize=7.5, loc="left", pad=2)
        for axes in list(grid.flat)[len(shown) :]:
            axes.set_visible(False)
        for axes in grid[:, 0]:
            axes.set_ylabel("mm")
        for i, axes in enumerate(grid.flat):
            if i < len(shown) and i + COLUMNS >= len(shown):
                axes.set_xlabel("s")
                axes.tick_params(labelbottom=True)
        grid[0, 0].set(ylim=(0, 1.05 * highest), xlim=(0, float(seconds.iloc[-1])))


def _table(
    count: int,
    facts: dict[str, Any],
    kinds: dict[str, str],
    summary: pd.DataFrame,
    cells: pd.DataFrame,
    identity: pd.DataFrame,
) -> Table:
    region = facts["primary_region"]
    here = summary[(summary["n_examples"] == count) & (summary["region"] == region)].set_index(["method", "metric"])
    lines = []
    for method, kind in kinds.items():
        mine = cells[(cells["method"] == method) & (cells["n_examples"] == count)]
        if (method, "vertex_l2_mean") not in here.index:
            lines.append((method, *["no result"] * (len(MEASURES) + 3)))
            continue
        error = here.loc[(method, "vertex_l2_mean")]
        values = [
            "n/a"
            if (method, metric) not in here.index or (metric == "noise_response" and kind == "reference")
            else number(float(here.loc[(method, metric), "mean"]), digits)
            for metric, _, digits in MEASURES
        ]
        spread = identity.loc[(identity["method"] == method) & (identity["n_examples"] == count), "spread_mm"].mean()
        rate = 1 / mine["seconds_per_expression"].median() if kind != "reference" else np.nan
        interval = f" {bounds(error['ci_low'], error['ci_high'])}" if np.isfinite(error["ci_low"]) else ""
        lines.append((method, f"{number(error['mean'])}{interval}", *values, number(spread), _rate(rate)))
    return Table(
        ("method", "error, mm", *(head for _, head, _ in MEASURES), "spread, mm", "frames/s"),
        tuple(lines),
        "Means over pairs. Acceleration error: of the truth's acceleration, 100 % is a face that does not move. "
        "Excess: acceleration beyond the truth's, in shares of the source's. Noise response: change of the result over "
        "that of the source, 1 passes noise on as it is. Spread: how far results of different sources on one target "
        "lie from each other, n/a with one source. Frames per second of the call alone, without set-up.",
    )


def _rate(value: float) -> str:
    return number(value, 2 if value < 100 else 0)
