"""A page of curves over one variable each, with pictures below them and the numbers behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import pandas as pd
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from reports.figures import STYLE
from reports.sheet import Picture, PictureRow, Pictures, Table, write_sheet
from reports.text import number

COLORS = ("#1d3557", "#c1121f", "#2a9d8f", "#e9a23b", "#6d597a", "#577590")
WIDTH, HEIGHT = 174 / 25.4, 2.1  # inches


@dataclass(frozen=True)
class Panel:
    """One plot. curves: by label, values in mm by the variable. ticks: what to print where values are categories."""

    title: str
    variable: str
    curves: Mapping[str, Mapping[float, float]]
    log: bool = False
    ticks: Mapping[float, str] | None = None


def write_curves_sheet(
    path: Path,
    title: str,
    description: str,
    panels: Sequence[Panel],
    numbers: pd.DataFrame,
    work: Path,
    pictures: Sequence[Pictures] = (),
) -> None:
    """Write the PDF; drawings go into the folder `work`, where those of `pictures` are already."""
    _plot(panels, work / "curves.svg")
    curves = Pictures(("",), (1.0,), (PictureRow((Picture("curves.svg"),)),), "")
    table = Table(
        tuple(str(column).replace("_", " ") for column in numbers.columns),
        tuple(tuple(_text(value) for value in row) for row in numbers.itertuples(index=False)),
        "Means over pairs and expressions; lengths in mm on the visible head.",
    )
    write_sheet(path, title, description, [curves, *pictures, table], work)


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}" if value == round(value) else number(value, 4)
    return str(value)


def _plot(panels: Sequence[Panel], path: Path) -> None:
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            for color, (label, curve) in zip(COLORS, panel.curves.items(), strict=False):
                axes.plot(list(curve), list(curve.values()), "-o", color=color, lw=1.4, ms=3, label=label)
            axes.set(title=panel.title, xlabel=panel.variable, ylabel="mm")
            axes.title.set_fontsize(8)
            axes.set(yscale="log") if panel.log else axes.set_ylim(bottom=0)
            every = sorted({x for curve in panel.curves.values() for x in curve})
            ticks = panel.ticks or {x: f"{x:g}" for x in every}
            axes.set_xticks(list(ticks), list(ticks.values()))
            if len(panel.curves) > 1:
                axes.legend(frameon=False, fontsize=6.5)
        FigureCanvasSVG(figure).print_svg(path, metadata={"Date": None})
