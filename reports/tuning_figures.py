"""Figures of trials: error against one searched setting, and slices through a space of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from reports.colors import REFERENCE_ROW, method_color
from reports.figures import WIDTH, canvas

Space = Mapping[str, Mapping[str, Any]]  # setting -> {log | linear: [low, high]} or {choices: [...]}

ACROSS = 4  # panels in a row
WIDE = 100  # of a logarithmic range: high / low from which powers of ten are ticks enough
TRIAL, CHOSEN = method_color(0), method_color(5)


def curves(trials: Mapping[str, pd.DataFrame], spaces: Mapping[str, Space], counts: Sequence[int], path: Path) -> None:
    """Error over the one setting that was searched: a panel for each method, a line for each number of examples."""
    across = min(ACROSS, len(trials))
    down = -(-len(trials) // across)
    with canvas(path, WIDTH, 1.85 * down + 0.35) as figure:
        panels = figure.subplots(down, across, sharey=True, squeeze=False)
        _margins(figure, bottom=0.42, top=0.45, between=0.62)
        for axes, (method, mine) in zip(panels.flat, trials.items(), strict=False):
            [(setting, domain)] = spaces[method].items()
            at = _along(axes, domain, mine[setting])
            order = np.argsort(at)
            for i, count in enumerate(counts):
                error = mine[f"error_{count}"].to_numpy(dtype=np.float64)
                axes.plot(
                    at[order], error[order], "-o", ms=2.2, lw=1.0, color=method_color(i), label=f"{count} examples"
                )
            _marked(axes, at, mine)
            axes.set_title(method, fontsize=8.5, loc="left")
            axes.set_xlabel(setting)
            axes.set_ylim(bottom=0)
        for axes in panels[:, 0]:
            axes.set_ylabel("error (mm)")
        _finish(figure, panels, len(trials))


def slices(mine: pd.DataFrame, space: Space, method: str, path: Path) -> None:
    """The error, averaged over numbers of examples, of every trial of one method over each setting in turn."""
    across = min(3, len(space))
    down = -(-len(space) // across)
    error = mine["error"].to_numpy(dtype=np.float64)
    with canvas(path, WIDTH, 1.7 * down + 0.3) as figure:
        panels = figure.subplots(down, across, sharey=True, squeeze=False)
        _margins(figure, bottom=0.42, top=0.3, between=0.42)
        for axes, (setting, domain) in zip(panels.flat, space.items(), strict=False):
            at = _along(axes, domain, mine[setting])
            other = ~(mine["chosen"] | (mine["trial"] == 0)).to_numpy(dtype=bool)
            axes.plot(at[other], error[other], "o", ms=4, color=TRIAL, mew=0, label="trial")
            for name, here, style in (
                ("present", (mine["trial"] == 0), {"marker": "D", "mfc": "none", "ms": 6.5, "color": "#222222"}),
                ("chosen", mine["chosen"], {"marker": "o", "ms": 4, "mew": 0, "color": CHOSEN}),
            ):
                at_it = here.to_numpy(dtype=bool)
                axes.plot(at[at_it], error[at_it], ls="none", label=name, **style)
            axes.set_xlabel(setting)
            _room(axes, error)
        for axes in panels[:, 0]:
            axes.set_ylabel("error (mm)")
        _finish(figure, panels, len(space))


def _along(axes: Axes, domain: Mapping[str, Any], values: pd.Series[Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Positions of a setting's values on the horizontal axis, which is made ready for them."""
    if "choices" in domain:
        listed = [str(value) for value in domain["choices"]]
        axes.set_xticks(range(len(listed)), listed)
        axes.set_xlim(-0.5, len(listed) - 0.5)
        place = list(domain["choices"])  # 2 is 2.0, as a column of numbers with gaps has it
        return np.array([place.index(value) for value in values], dtype=np.float64)
    low, high = next(domain[name] for name in ("log", "linear") if name in domain)
    if "log" in domain:
        margin = (high / low) ** 0.04
        axes.set_xscale("log")
        axes.set_xlim(low / margin, high * margin)
        if high / low < WIDE:
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter("{x:g}")
        else:
            axes.xaxis.set_major_locator(LogLocator(numticks=5))
        axes.xaxis.set_minor_locator(NullLocator())
    else:
        axes.set_xlim(low - 0.04 * (high - low), high + 0.04 * (high - low))
    return values.to_numpy(dtype=np.float64)


def _marked(axes: Axes, at: np.ndarray[Any, Any], mine: pd.DataFrame) -> None:
    """Vertical lines where the present and the chosen value are."""
    lines: tuple[tuple[str, pd.Series[bool], dict[str, Any]], ...] = (
        ("present", mine["trial"] == 0, {"color": REFERENCE_ROW, "lw": 2.6}),
        ("chosen", mine["chosen"], {"color": "#222222", "lw": 0.8, "ls": "--"}),
    )
    for name, here, style in lines:
        for number, x in enumerate(at[here.to_numpy(dtype=bool)]):
            axes.axvline(x, zorder=0, label="" if number else name, **style)


def _room(axes: Axes, error: np.ndarray[Any, Any]) -> None:
    found = error[np.isfinite(error)]
    if len(found):
        margin = max(0.08 * np.ptp(found), 0.02 * found.max())
        axes.set_ylim(found.min() - margin, found.max() + margin)


def _margins(figure: Figure, bottom: float, top: float, between: float) -> None:
    """In inches."""
    height, panel = figure.get_figheight(), 1.2
    figure.subplots_adjust(
        left=0.09, right=0.985, bottom=bottom / height, top=1 - top / height, hspace=between / panel, wspace=0.12
    )


def _finish(figure: Figure, panels: np.ndarray[Any, Any], used: int) -> None:
    for axes in panels.flat[used:]:
        axes.set_visible(False)
    for axes in panels.flat[:used]:
        axes.grid(axis="y", color="#e6e6e6", lw=0.5)
        axes.set_axisbelow(True)
    named: dict[str, Any] = {}
    for axes in panels.flat[:used]:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    figure.legend(
        list(named.values()), list(named), loc="upper right", ncols=len(named), frameon=False, fontsize=7.5,
        borderaxespad=0.1, handletextpad=0.5, columnspacing=1.4,
    )  # fmt: skip
