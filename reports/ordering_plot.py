"""Mean errors of all methods under several conditions: a panel for each number of examples, a row for each method."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from reports.colors import method_color
from reports.figures import (
    MARKERS,
    WIDTH,
    canvas,
    conditions_legend,
    error_name,
    exact,
    finish_panels,
    legend_height,
    no_result,
    panels_of,
)
from reports.ordering import Ordering
from reports.text import ROUNDING

ROW = 0.23  # inches


def ordering_plot(ordering: Ordering, path: Path) -> None:
    """Means with their nominal 95 % intervals; methods as `Ordering.methods` orders them."""
    methods = [method for method in ordering.methods if method.name != "neutral"]  # its error is the motion itself
    counts = ordering.counts
    names = ordering.conditions
    legend = legend_height(names)
    row = ROW + 0.035 * max(len(names) - 3, 0)
    height = 0.2 + row * len(methods) + 0.4 + legend
    with canvas(path, WIDTH, height) as figure:
        panels = panels_of(figure, len(counts), bottom=0.4 + legend)
        spread = 0.62 * (np.arange(len(names)) - (len(names) - 1) / 2) / max(len(names), 2)
        shown: list[float] = []
        for axes, count in zip(panels, counts, strict=True):
            for i, method in enumerate(methods):
                if i % 2:
                    axes.axhspan(i - 0.5, i + 0.5, color="#f4f4f4", lw=0, zorder=0)
                mean = ordering.values(method.name, count)
                low, high = (ordering.values(method.name, count, column) for column in ("ci_low", "ci_high"))
                if np.isnan(mean).all():
                    no_result(axes, i)
                for j in np.flatnonzero(mean <= ROUNDING):
                    exact(axes, i + float(spread[j]), method_color(int(j)))
                for j in np.flatnonzero(mean > ROUNDING):
                    color = method_color(int(j))
                    axes.plot([low[j], high[j]], [i + spread[j]] * 2, lw=1.0, color=color, alpha=0.8)
                    axes.plot(
                        mean[j], i + spread[j], MARKERS[j % len(MARKERS)], ms=3.6, color=color, mec="white", mew=0.4
                    )
                if method.kind != "reference":
                    seen = mean > ROUNDING
                    shown += [*mean[seen].tolist(), *low[seen & (low > mean / 3)].tolist(), *high[seen].tolist()]
            axes.set_title(f"{count} examples", fontsize=7.5, pad=3)
        finish_panels(figure, panels, methods, shown, error_name(ordering.studies[0]), legend)
        conditions_legend(figure, names)
