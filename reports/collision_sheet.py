"""The page of the study of lip collisions: mouths before and after, sections through the lips, how far it is felt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from reports.camera import look
from reports.figures import STYLE
from reports.render import render_mesh, write_image
from reports.section import section
from reports.sheet import Picture, PictureRow, Pictures, Table, write_sheet
from reports.text import number, seconds
from retarget.types import FloatArray, Pair

SIZE = (560, 390)  # pixels
BEFORE, AFTER = "#c1121f", "#1d3557"
AROUND = 26.0  # mm about the middle of the mouth
WINDOW = 7.0  # mm about the deepest point of a section


@dataclass(frozen=True)
class Case:
    """An expression whose lips cross. row: its line of the table."""

    row: Mapping[str, Any]
    pair: Pair
    before: FloatArray  # (n, 3) mm, collisions left alone
    after: FloatArray  # (n, 3) mm
    worst: int  # the deepest vertex before
    away: FloatArray  # (n,) mm from the nearest contact


def write_collision_sheet(
    path: Path,
    title: str,
    description: str,
    cases: Sequence[Case],
    summary: pd.DataFrame,
    spread: pd.DataFrame,
    work: Path,
) -> None:
    """Write the PDF; pictures go into the folder `work`."""
    rows = tuple(_row(case, f"case{i}", work) for i, case in enumerate(cases))
    _spread_plot(spread, work / "spread.svg")
    write_sheet(
        path,
        title,
        description,
        [
            Pictures(
                ("lips cross", "resolved", "section"),
                (1.0, 1.0, 0.76),
                rows,
                "The deepest cases, from as many pairs as there are. Red: collisions left alone, blue: resolved. The "
                "section is sagittal, through the deepest point, seen from the character's left.",
            ),
            Pictures(
                ("",),
                (1.0,),
                (PictureRow((Picture("spread.svg"),)),),
                "How far the resolution of a collision is felt: displacement of the visible skin by its distance from "
                "the nearest contact. Line: median over all cases of the mean displacement, band: from the first to "
                "the ninth decile; dots: the largest displacement of any vertex of any case.",
            ),
            _table(summary),
        ],
        work,
    )


def _row(case: Case, name: str, work: Path) -> PictureRow:
    middle = case.before[case.pair.regions.landmarks["stomion_upper"]]
    mouth = np.abs(case.before - middle).max(axis=1) < AROUND
    camera = look(case.before[mouth], SIZE, turn=28.0, raise_=4.0, margin=0.0)
    for when, skin in (("before", case.before), ("after", case.after)):
        write_image(work / f"{name}-{when}.jpg", render_mesh(skin, case.pair.faces, camera, SIZE, samples=3))
    _section_plot(case, work / f"{name}-section.svg")
    row = case.row
    return PictureRow(
        (
            Picture(f"{name}-before.jpg", f"{number(row['depth_before_mm'], 2)} mm deep"),
            Picture(f"{name}-after.jpg", f"{number(row['depth_after_mm'], 2)} mm deep"),
            Picture(f"{name}-section.svg", ""),
        ),
        f"{row['expression']}, {row['source']} to {row['target']}",
    )


def _section_plot(case: Case, path: Path) -> None:
    x, y, z = case.before[case.worst]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(1.9, 1.78))
        axes = figure.add_axes((0.22, 0.2, 0.75, 0.78))
        for skin, color in ((case.before, BEFORE), (case.after, AFTER)):
            axes.add_collection(LineCollection(list(section(skin, case.pair.faces, x) - [z, y]), colors=color, lw=1.2))
        axes.set(xlim=(-WINDOW, WINDOW), ylim=(-WINDOW, WINDOW), aspect="equal")
        axes.set(xlabel="forward (mm)", ylabel="up (mm)", xticks=(-5, 0, 5), yticks=(-5, 0, 5))
        FigureCanvasSVG(figure).print_svg(path, metadata={"Date": None})


def _spread_plot(spread: pd.DataFrame, path: Path) -> None:
    grouped = spread.groupby("from_mm")
    at = [(low + high) / 2 for low, high in spread.groupby("from_mm")["to_mm"].first().items()]
    mean = grouped["moved_mean_mm"]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(174 / 25.4, 1.6), layout="constrained")
        axes = figure.add_subplot()
        axes.fill_between(at, mean.quantile(0.1), mean.quantile(0.9), color=AFTER, alpha=0.2, lw=0)
        axes.plot(at, mean.median(), "-o", color=AFTER, lw=1.4, ms=3)
        axes.plot(at, grouped["moved_max_mm"].max(), "o", color=BEFORE, ms=3)
        axes.set(
            yscale="log", ylim=(1e-4, None), xlabel="distance from the nearest contact (mm)", ylabel="displacement (mm)"
        )
        FigureCanvasSVG(figure).print_svg(path, metadata={"Date": None})


def _table(summary: pd.DataFrame) -> Table:
    rows = tuple(
        (
            str(row["pair"]),
            str(row["expressions"]),
            str(row["crossing"]),
            str(row["resolved"]),
            f"{number(row['depth_before_median_mm'], 2)}, {number(row['depth_before_max_mm'], 2)}",
            f"{number(row['depth_after_median_mm'], 2)}, {number(row['depth_after_max_mm'], 2)}",
            str(row["truth_crossing"]),
            seconds(row["seconds_before"]),
            seconds(row["seconds_after"]),
        )
        for row in summary.to_dict("records")
    )
    heads = ("pair", "expressions", "cross", "resolved", "before mm", "after mm", "truth too", "time", "resolving")
    return Table(
        heads,
        rows,
        "Expressions that cross, and those that are left without a vertex deeper than the study's limit. Depths are "
        "median and largest over the crossing expressions, by the winding number of the whole skin, 10 mm and more "
        "from the corners of the mouth. Truth too: those where the dataset's own expression crosses. Times are medians "
        "for the whole method.",
    )
