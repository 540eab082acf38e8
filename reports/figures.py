"""Vector figures of a study: errors as in Fig. 10 of the paper, ratios to the reference, effect of examples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedFormatter, FixedLocator, NullFormatter, NullLocator

from reports.cells import blocks
from reports.colors import REFERENCE_ROW, method_color
from reports.load import MethodFacts, StudyResults
from reports.text import ROUNDING
from retarget.types import FloatArray

WIDTH = 170 / 25.4  # inches: the text width of the report
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")  # of conditions, whose colours differ too
LEGEND_LETTERS = 115  # on one line
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": "#222222",
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "svg.fonttype": "path",
    "svg.hashsalt": "report",
}


def pair_values(study: StudyResults) -> pd.DataFrame:
    """One value per pair: columns method, n_examples, value, on the cells that all compared methods finished."""
    metric, region = study.facts["primary_metric"], study.facts["primary_region"]
    rows = study.metrics[(study.metrics["metric"] == metric) & (study.metrics["region"] == region)]
    found = [
        pd.DataFrame(
            {
                "method": method,
                "n_examples": block.n_examples,
                "value": block.clusters.pair_means(block.cells(method, metric, region)),
            }
        )
        for block in blocks(rows)
        for method in block.compared
    ]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=["method", "n_examples", "value"])


def box_plot(studies: Sequence[StudyResults], names: Sequence[str], path: Path) -> None:
    """Errors by example count as in Fig. 10: a row per method, a box over pairs per study, each pair a dot.

    One study has its boxes in the colours of its rows; several (`names`, the conditions) in colours of their own.
    """
    methods = list({m.name: m for study in studies for m in _drawn(study)}.values())
    counts = sorted({count for study in studies for count in study.facts["n_examples"]})
    values = [pair_values(study) for study in studies]
    row = 0.2 if len(studies) == 1 else 0.07 + 0.105 * len(studies)
    legend = legend_height(names) if len(studies) > 1 else 0.0
    height = 0.2 + row * len(methods) + 0.42 + legend
    step = 0.84 / len(studies)
    with canvas(path, WIDTH, height) as figure:
        panels = panels_of(figure, len(counts), bottom=0.42 + legend)
        shown: list[float] = []
        for axes, count in zip(panels, counts, strict=True):
            for i, m in enumerate(methods):
                if i % 2:
                    axes.axhspan(i - 0.5, i + 0.5, color="#f5f5f5", lw=0, zorder=0)
                for j, (study, table) in enumerate(zip(studies, values, strict=True)):
                    here = table[(table["method"] == m.name) & (table["n_examples"] == count)]["value"].to_numpy()
                    at = i + (j - (len(studies) - 1) / 2) * step
                    color = row_color(study, m) if len(studies) == 1 else method_color(j)
                    if len(here) == 0:
                        no_result(axes, at)
                    elif (here <= ROUNDING).any():
                        exact(axes, at, color)
                    here = here[here > ROUNDING]
                    if len(here) == 0:
                        continue
                    _box(axes, at, step * 0.74, here, color)
                    if m.kind != "reference":
                        shown += [float(here.min()), float(here.max())]
            axes.set_title(f"{count} examples", fontsize=7.5, pad=3)
        finish_panels(figure, panels, methods, shown, error_name(studies[0]), legend)
        if legend:
            conditions_legend(figure, names, markers=False)


def example_effect(study: StudyResults, path: Path) -> None:
    """Mean error with its 95 % interval over the number of examples: a small plot per method, all others in grey."""
    methods, counts = _drawn(study), study.facts["n_examples"]
    at = np.arange(len(counts))
    curves = {m.name: _curves(study, m, counts) for m in methods}
    shown = [value for m in methods if m.kind != "reference" for value in _positive(*curves[m.name])]
    with _small_plots(path, methods, counts, line=1.02, margin=-0.06, below=0.36, hspace=0.28) as (figure, grid):
        for axes, m in zip(grid.flat, methods, strict=False):
            for other in methods:
                if other.kind != "reference":
                    axes.plot(at, curves[other.name][0], color="#cccccc", lw=0.6, zorder=1)
            mean, low, high = curves[m.name]
            color = row_color(study, m)
            axes.plot(at, mean, "-o", ms=2.6, lw=1.3, color=color, zorder=3)
            axes.vlines(at, low, high, color=color, lw=1.1, zorder=3)
            if not np.isfinite(mean).any():
                axes.text(0.5, 0.5, "no result", transform=axes.transAxes, ha="center", fontsize=6, color="#a3216f")
            elif (mean <= ROUNDING).any():
                axes.text(0.04, 0.05, "exact", transform=axes.transAxes, fontsize=6, color=color)
        _finish_small(figure, grid, counts, shown, error_name(study))


def condition_effect(studies: Sequence[StudyResults], names: Sequence[str], path: Path) -> None:
    """Mean error with its 95 % interval over the number of examples: a small plot per method, a line per condition."""
    methods = list({m.name: m for study in studies for m in _drawn(study)}.values())
    counts = sorted({count for study in studies for count in study.facts["n_examples"]})
    legend = legend_height(names)
    spread = 0.3 * (np.arange(len(studies)) - (len(studies) - 1) / 2) / max(len(studies), 2)
    shown: list[float] = []
    below = 0.36 + legend
    with _small_plots(path, methods, counts, line=0.95, margin=0.12, below=below, hspace=0.3) as (figure, grid):
        for axes, m in zip(grid.flat, methods, strict=False):
            for j, study in enumerate(studies):
                mean, low, high = _curves(study, m, counts)
                color, at = method_color(j), np.arange(len(counts)) + spread[j]
                if (mean <= ROUNDING).any():
                    axes.text(0.04, 0.05, "exact", transform=axes.transAxes, fontsize=5.5, color=color)
                mean = np.where(mean > ROUNDING, mean, np.nan)
                axes.plot(at, mean, "-", lw=1.0, color=color, marker=MARKERS[j % len(MARKERS)], ms=2.6, mew=0)
                axes.vlines(at, np.where(low > ROUNDING, low, np.nan), high, color=color, lw=0.8)
                if m.kind != "reference":
                    shown += _positive(mean, low, high)
        _finish_small(figure, grid, counts, shown, error_name(studies[0]), legend)
        conditions_legend(figure, names)


def _curves(study: StudyResults, method: MethodFacts, counts: Sequence[int]) -> FloatArray:
    """(3, c) mean and its interval at each number of examples, NaN where there is none."""
    rows = study.primary[study.primary["method"] == method.name].set_index("n_examples").reindex(list(counts))
    return np.asarray(rows[["mean", "ci_low", "ci_high"]].to_numpy(dtype=np.float64).T)


def _positive(mean: FloatArray, low: FloatArray, high: FloatArray) -> list[float]:
    """What a logarithmic axis must hold of a curve: intervals that reach far down are cut."""
    return [value for value in (*mean, *np.maximum(low, mean / 2), *high) if value > ROUNDING]


@contextmanager
def _small_plots(
    path: Path, methods: Sequence[MethodFacts], counts: Sequence[int], line: float, margin: float, below: float,
    hspace: float,
) -> Iterator[tuple[Figure, Any]]:  # fmt: skip
    """A small plot for each method, with common axes; line, margin and below in inches."""
    columns = min(5, len(methods))
    lines = -(-len(methods) // columns)
    height = line * lines + margin + below
    with canvas(path, WIDTH, height) as figure:
        grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
        figure.subplots_adjust(
            left=0.07, right=0.995, bottom=below / height, top=1 - 0.16 / height, wspace=0.08, hspace=hspace
        )
        for i, axes in enumerate(grid.flat):
            axes.set_visible(i < len(methods))
            axes.set_xticks(range(len(counts)), [str(count) for count in counts])
            axes.tick_params(labelbottom=i < len(methods) <= i + columns, labelleft=i % columns == 0, length=2)
            axes.grid(axis="y", color="#ececec", lw=0.4)
            axes.set_axisbelow(True)
        for axes, m in zip(grid.flat, methods, strict=False):
            axes.set_title(m.label, fontsize=7, loc="left", pad=2)
        yield figure, grid


def _finish_small(
    figure: Figure, grid: Any, counts: Sequence[int], shown: list[float], name: str, above: float = 0.0
) -> None:
    """A logarithmic axis that holds what is shown, and the names of both axes, the lower one `above` so many inches."""
    if shown:
        log_ticks(grid[0, 0], "y", min(shown), max(shown))
    for axes in grid.flat:
        axes.set_xlim(-0.3, len(counts) - 0.7)
    figure.text(0.53, (0.03 + above) / figure.get_figheight(), "target examples", ha="center", va="bottom")
    figure.text(0.004, 0.5, name, rotation=90, ha="left", va="center")


def conditions_legend(figure: Figure, names: Sequence[str], markers: bool = True) -> None:
    """The colour of each condition, and its marker, at the lower edge; `legend_height` inches."""
    handles: list[Artist] = [
        Line2D([], [], color=method_color(j), marker=MARKERS[j % len(MARKERS)], ms=4, mec="white", mew=0.4, label=name)
        if markers
        else Patch(facecolor=method_color(j), alpha=0.6, label=name)
        for j, name in enumerate(names)
    ]
    figure.legend(handles=handles, loc="lower center", ncols=_legend_columns(names), frameon=False,
                  bbox_to_anchor=(0.5, 0.0), borderpad=0.3, borderaxespad=0, columnspacing=1.8)  # fmt: skip


def legend_height(names: Sequence[str]) -> float:
    """Inches that `conditions_legend` needs."""
    return 0.08 + 0.17 * -(-len(names) // _legend_columns(names))


def _legend_columns(names: Sequence[str]) -> int:
    wide = sum(len(name) + 6 for name in names) > LEGEND_LETTERS
    return max(LEGEND_LETTERS // (max(map(len, names)) + 6), 1) if wide else len(names)


def panels_of(figure: Figure, count: int, bottom: float) -> list[Axes]:
    """Plots side by side that share the names of rows on the left; bottom in inches."""
    height = figure.get_figheight()
    panels = figure.subplots(1, count, sharey=True, squeeze=False)[0]
    figure.subplots_adjust(left=0.2, right=0.99, bottom=bottom / height, top=1 - 0.2 / height, wspace=0.08)
    return list(panels)


def finish_panels(
    figure: Figure, panels: Sequence[Axes], methods: Sequence[MethodFacts], shown: list[float], name: str, above: float
) -> None:
    """Common logarithmic axes, the names of the rows, and the name of the axis `above` so many inches."""
    for axes in panels:
        axes.grid(axis="x", color="#e2e2e2", lw=0.5)
        axes.set_axisbelow(True)
        axes.tick_params(axis="y", length=0)
        log_ticks(axes, "x", min(shown, default=0.1), max(shown, default=1.0))
    panels[0].set_yticks(range(len(methods)), [m.label for m in methods])
    panels[0].set_ylim(len(methods) - 0.5, -0.5)
    figure.text(0.595, (0.03 + above) / figure.get_figheight(), name, ha="center", va="bottom")


def exact(axes: Axes, at: float, color: str) -> None:
    """Mark a row whose value is zero up to rounding at the left edge: a logarithmic axis has no place for it."""
    axes.text(
        0.02, at, "exact", ha="left", va="center", fontsize=5.5, color=color, transform=axes.get_yaxis_transform()
    )  # fmt: skip


def no_result(axes: Axes, at: float) -> None:
    """Say in a row that it is empty."""
    axes.text(
        0.5, at, "no result", ha="center", va="center", fontsize=6, color="#a3216f",
        transform=axes.get_yaxis_transform(),
    )  # fmt: skip


def ratio_plot(study: StudyResults, tests: pd.DataFrame, path: Path) -> None:
    """Each method's error divided by the reference's: a dot per pair, the geometric mean and its 95 % interval.

    tests holds the rows of `summary.paired_tests` to show.
    """
    values, counts = pair_values(study), study.facts["n_examples"]
    names = [m for m in study.methods if m.name in set(tests["method"])]
    reference = study.facts["reference"]
    with canvas(path, WIDTH, 0.65 + 0.18 * max(len(names), 1)) as figure:
        panels = panels_of(figure, len(counts), bottom=0.45)
        everything: list[float] = [0.9, 1.1]
        for axes, count in zip(panels, counts, strict=True):
            here = values[values["n_examples"] == count]
            other = here[here["method"] == reference]["value"].to_numpy()
            rows = tests[tests["n_examples"] == count].set_index("method")
            for i, m in enumerate(names):
                mine = here[here["method"] == m.name]["value"].to_numpy()
                if m.name not in rows.index or len(mine) == 0 or len(mine) != len(other):
                    no_result(axes, i)
                    continue
                r = rows.loc[m.name]
                if (mine <= ROUNDING).any():
                    exact(axes, i, row_color(study, m))
                known = (mine > ROUNDING) & (other > ROUNDING)
                if not known.all():
                    continue
                ratios = mine / other
                axes.plot(ratios, i + _spread(len(ratios)), ".", ms=4.5, color=row_color(study, m), alpha=0.45, mew=0)
                axes.plot([r["ratio_low"], r["ratio_high"]], [i, i], lw=1.6, color=row_color(study, m))
                axes.plot(r["ratio"], i, "D", ms=3.6, color=row_color(study, m), mec="white", mew=0.5)
                everything += [*ratios.tolist(), float(r["ratio_low"]), float(r["ratio_high"])]
            axes.axvline(1, color="#555555", lw=0.7, zorder=0)
            axes.set_title(f"{count} examples", fontsize=7.5, pad=3)
        finite = [value for value in everything if np.isfinite(value) and value > 0]
        name = f"error / error of {study.label(reference)}   (left of 1: smaller error)"
        finish_panels(figure, panels, names, finite, name, 0.0)


def _box(axes: Axes, at: float, width: float, values: FloatArray, color: str) -> None:
    axes.boxplot(
        [values],
        positions=[at],
        widths=width,
        orientation="horizontal",
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": color, "alpha": 0.38, "edgecolor": color, "linewidth": 0.8},
        medianprops={"color": "#111111", "linewidth": 1.1},
        whiskerprops={"color": color, "linewidth": 0.8},
        capprops={"color": color, "linewidth": 0.8},
        manage_ticks=False,
    )
    axes.plot(values, at + width * 0.5 * _spread(len(values)), ".", ms=3.0, color=color, alpha=0.8, mew=0)


def _spread(count: int) -> FloatArray:
    """(count,) offsets in [-0.3, 0.3] that keep dots apart, the same every time."""
    return np.asarray((np.arange(count) * 0.618034 % 1 - 0.5) * 0.6, dtype=np.float64)


def _drawn(study: StudyResults) -> list[MethodFacts]:
    """The rows that a plot shows: all but the neutral, whose error is the motion itself."""
    return [m for m in study.methods if m.name != "neutral"]


def row_color(study: StudyResults, method: MethodFacts) -> str:
    """The colour of a row in every figure."""
    if method.kind == "reference":
        return REFERENCE_ROW
    return method_color([m.name for m in study.methods if m.kind != "reference"].index(method.name))


def error_name(study: StudyResults) -> str:
    metric = study.facts["primary_metric"]
    name = "vertex error, L2" if metric == "vertex_l2_mean" else metric.replace("_", " ")
    units = study.metrics.loc[study.metrics["metric"] == metric, "unit"].unique()
    return f"{name} ({units[0]})" if len(units) else name


def log_ticks(axes: Axes, which: str, low: float, high: float) -> None:
    """A logarithmic axis with plain numbers at 1, 2, 5 of each decade, or fewer where they would touch."""
    margin = (high / low) ** 0.06
    points = 72 / axes.figure.dpi * (axes.bbox.width if which == "x" else axes.bbox.height)
    ticks = _log_steps(low / margin, high * margin, points, apart=24 if which == "x" else 11)
    if which == "x":
        axes.set_xscale("log")
        axes.set_xlim(low / margin, high * margin)
    else:
        axes.set_yscale("log")
        axes.set_ylim(low / margin, high * margin)
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FixedFormatter([f"{tick:g}" for tick in ticks]))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def _log_steps(low: float, high: float, points: float, apart: float) -> list[float]:
    """Round numbers in [low, high], at least `apart` from each other on a logarithmic axis of length `points`."""
    per_decade = points / np.log10(high / low)
    dense = ((factors, gap) for factors, gap in (((1, 2, 5), 2), ((1, 3), 3)) if np.log10(gap) * per_decade >= apart)
    factors: tuple[int, ...] = next(dense, ((1,), 10))[0]
    every = max(int(np.ceil(apart / per_decade)), 1)
    return [m * 10.0**e for e in range(-6, 7) if e % every == 0 for m in factors if low <= m * 10.0**e <= high]


@contextmanager
def canvas(path: Path, width: float, height: float) -> Iterator[Figure]:
    """A figure that is written as SVG; sizes in inches."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        FigureCanvasSVG(figure)
        yield figure
        figure.savefig(path, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
