"""Vector figures of a study: errors as in Fig. 10 of the paper, ratios to the reference, effect of examples."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedFormatter, FixedLocator, NullFormatter, NullLocator

from reports.cells import blocks
from reports.colors import COLORS, REFERENCE_ROW, method_color
from reports.load import MethodFacts, StudyResults
from retarget.types import FloatArray

WIDTH = 170 / 25.4  # inches: the text width of the report
LEGEND_COLUMNS = 5
MARKERS, HATCHES = ("o", "s", "^"), ("", "/////", ".....")  # of methods beyond the colours
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


def box_plot(study: StudyResults, path: Path) -> None:
    """Errors grouped by example count, one box per method over pairs, as in Fig. 10; each pair is a dot."""
    values, methods = pair_values(study), _drawn(study)
    counts = study.facts["n_examples"]
    legend = _legend_height(methods)
    with canvas(path, WIDTH, 2.8 + legend) as figure:
        axes = figure.add_axes(_above(figure, legend + 0.25))
        step = 0.84 / max(len(methods), 1)
        for group, count in enumerate(counts):
            for i, m in enumerate(methods):
                here = values[(values["method"] == m.name) & (values["n_examples"] == count)]["value"].to_numpy()
                at = group + (i - (len(methods) - 1) / 2) * step
                if len(here) == 0:
                    axes.text(at, 0, "no result", rotation=90, ha="center", va="bottom", fontsize=6, color="#a3216f")
                    continue
                _box(axes, at, step * 0.72, here, row_color(study, m), _turn(study, m))
        for edge in range(1, len(counts)):
            axes.axvline(edge - 0.5, color="#dddddd", lw=0.6, zorder=0)
        axes.set_xlim(-0.5, len(counts) - 0.5)
        axes.set_ylim(0, axes.get_ylim()[1] * 1.03)
        axes.set_xticks(range(len(counts)), [f"{count} examples" for count in counts], fontsize=8.5)
        axes.tick_params(axis="x", length=0, pad=5)
        axes.set_ylabel(error_name(study))
        axes.grid(axis="y", color="#e6e6e6", lw=0.5)
        axes.set_axisbelow(True)
        _legend(figure, study, methods)


def example_effect(study: StudyResults, path: Path) -> None:
    """Mean error with its 95 % interval over the number of examples, on a logarithmic scale that holds the methods."""
    primary, methods, counts = study.primary, _drawn(study), study.facts["n_examples"]
    legend = _legend_height(methods)
    with canvas(path, WIDTH, 2.25 + legend) as figure:
        axes = figure.add_axes(_above(figure, legend + 0.4))
        spread = 0.3 / max(len(methods), 1)
        lows, highs = [], []
        for i, m in enumerate(methods):
            rows = primary[primary["method"] == m.name].set_index("n_examples").reindex(counts)
            mean = rows["mean"].to_numpy(dtype=np.float64)
            low, high = rows["ci_low"].to_numpy(dtype=np.float64), rows["ci_high"].to_numpy(dtype=np.float64)
            if not (np.isfinite(mean) & (mean > 0)).any():
                continue
            at = np.arange(len(counts)) + (i - (len(methods) - 1) / 2) * spread
            color = row_color(study, m)
            style = "--" if m.kind == "reference" else "-"
            axes.plot(at, mean, style, marker=MARKERS[_turn(study, m)], ms=3, lw=1.0, color=color)
            axes.vlines(at, low, high, color=color, lw=1.0)
            if m.kind != "reference":
                lows.append(np.nanmin(np.where(low > 0, low, mean)))
                highs.append(np.nanmax(np.where(np.isfinite(high), high, mean)))
        if lows:
            log_ticks(axes, "y", float(min(lows)), float(max(highs)))
        axes.set_xlim(-0.4, len(counts) - 0.6)
        axes.set_xticks(range(len(counts)), [str(count) for count in counts])
        axes.set_xlabel("target examples")
        axes.set_ylabel(error_name(study))
        axes.grid(axis="y", color="#e6e6e6", lw=0.5)
        axes.set_axisbelow(True)
        _legend(figure, study, methods)


def ratio_plot(study: StudyResults, tests: pd.DataFrame, path: Path) -> None:
    """Each method's error divided by the reference's: a dot per pair, the geometric mean and its 95 % interval.

    tests holds the rows of `summary.paired_tests` to show.
    """
    values, counts = pair_values(study), study.facts["n_examples"]
    names = [m for m in study.methods if m.name in set(tests["method"])]
    with canvas(path, WIDTH, 0.65 + 0.22 * max(len(names), 1)) as figure:
        panels = figure.subplots(1, len(counts), sharey=True, squeeze=False)[0]
        bottom = 0.47 / figure.get_figheight()
        figure.subplots_adjust(left=0.2, right=0.99, bottom=bottom, top=1 - 0.2 / figure.get_figheight(), wspace=0.08)
        everything: list[float] = []
        for axes, count in zip(panels, counts, strict=True):
            here = values[values["n_examples"] == count]
            other = here[here["method"] == study.facts["reference"]]["value"].to_numpy()
            rows = tests[tests["n_examples"] == count].set_index("method")
            for i, m in enumerate(names):
                mine = here[here["method"] == m.name]["value"].to_numpy()
                if m.name not in rows.index or len(mine) == 0 or len(mine) != len(other):
                    axes.text(
                        0.5, i, "no result", ha="center", va="center", fontsize=6, color="#a3216f",
                        transform=axes.get_yaxis_transform(),
                    )  # fmt: skip
                    continue
                r = rows.loc[m.name]
                ratios = mine / other
                axes.plot(ratios, i + _spread(len(ratios)), ".", ms=4.5, color=row_color(study, m), alpha=0.45, mew=0)
                axes.plot([r["ratio_low"], r["ratio_high"]], [i, i], lw=1.6, color=row_color(study, m))
                axes.plot(r["ratio"], i, "D", ms=3.6, color=row_color(study, m), mec="white", mew=0.5)
                everything += [*ratios.tolist(), float(r["ratio_low"]), float(r["ratio_high"])]
            axes.axvline(1, color="#555555", lw=0.7, zorder=0)
            axes.set_title(f"{count} examples", fontsize=7.5, pad=3)
            axes.grid(axis="x", color="#e6e6e6", lw=0.5)
            axes.set_axisbelow(True)
            axes.tick_params(axis="y", length=0)
        finite = [value for value in everything if np.isfinite(value)] or [1.0]
        for axes in panels:
            log_ticks(axes, "x", min(*finite, 0.9), max(*finite, 1.1))
        panels[0].set_yticks(range(len(names)), [m.label for m in names])
        panels[0].set_ylim(len(names) - 0.5, -0.5)
        reference = study.label(study.facts["reference"])
        figure.text(
            0.595,
            0.05 / figure.get_figheight(),
            f"error / error of {reference}   (left of 1: smaller error)",
            ha="center",
            va="bottom",
        )


def _box(axes: Axes, at: float, width: float, values: FloatArray, color: str, turn: int) -> None:
    axes.boxplot(
        [values],
        positions=[at],
        widths=width,
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": color, "alpha": 0.38, "edgecolor": color, "linewidth": 0.8, "hatch": HATCHES[turn]},
        medianprops={"color": "#111111", "linewidth": 1.1},
        whiskerprops={"color": color, "linewidth": 0.8},
        capprops={"color": color, "linewidth": 0.8},
        manage_ticks=False,
    )
    axes.plot(at + width * 0.5 * _spread(len(values)), values, ".", ms=4.0, color=color, alpha=0.8, mew=0)


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


def _turn(study: StudyResults, method: MethodFacts) -> int:
    """How often the colours were gone through before this method: it has another marker and hatch then."""
    if method.kind == "reference":
        return 0
    index = [m.name for m in study.methods if m.kind != "reference"].index(method.name)
    return min(index // COLORS, len(MARKERS) - 1)


def error_name(study: StudyResults) -> str:
    metric = study.facts["primary_metric"]
    name = "vertex error, L2" if metric == "vertex_l2_mean" else metric.replace("_", " ")
    units = study.metrics.loc[study.metrics["metric"] == metric, "unit"].unique()
    return f"{name} ({units[0]})" if len(units) else name


def _legend_height(methods: list[MethodFacts]) -> float:
    """Inches."""
    return 0.1 + 0.17 * -(-len(methods) // LEGEND_COLUMNS)


def _above(figure: Figure, bottom: float) -> tuple[float, float, float, float]:
    """A place for axes that leaves `bottom` inches below."""
    height = figure.get_figheight()
    return 0.095, bottom / height, 0.9, 1 - (bottom + 0.08) / height


def _legend(figure: Figure, study: StudyResults, methods: list[MethodFacts]) -> None:
    rows = -(-len(methods) // LEGEND_COLUMNS)
    columns = -(-len(methods) // max(rows, 1))
    by_column = [m for column in range(columns) for m in methods[column::columns]]  # matplotlib fills columns first
    handles = [
        Patch(
            facecolor=row_color(study, m),
            alpha=0.6,
            edgecolor=row_color(study, m),
            label=m.label,
            hatch=HATCHES[_turn(study, m)],
        )
        for m in by_column
    ]
    figure.legend(
        handles=handles,
        loc="lower center",
        ncols=max(columns, 1),
        frameon=False,
        bbox_to_anchor=(0.53, 0.0),
        handlelength=1.1,
        handleheight=0.9,
        columnspacing=1.6,
        borderpad=0.4,
        borderaxespad=0,
    )


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
    steps = ((1, (1, 2, 5), np.log10(2)), (1, (1, 3), np.log10(3)), (1, (1,), 1.0), (2, (1,), 2.0), (3, (1,), 3.0))
    every, factors, _ = next((step for step in steps if step[2] * per_decade >= apart), steps[-1])
    return [m * 10.0**e for e in range(-6, 7, every) for m in factors if low <= m * 10.0**e <= high]


@contextmanager
def canvas(path: Path, width: float, height: float) -> Iterator[Figure]:
    """A figure that is written as SVG; sizes in inches."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        FigureCanvasSVG(figure)
        yield figure
        figure.savefig(path, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
