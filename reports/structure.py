"""Fig. 7 of the paper as a diagram: what each method is given, what it does in order, and what comes out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.text import Text

from reports.figures import WIDTH, canvas

_GIVEN, _STEP, _RESULT, _LINE = "#dbe9f6", "#fdebd3", "#cfe8dc", "#555555"
_SIDE, _GAP, _TOP, _BOX, _ROW = 0.74, 0.17, 0.27, 0.46, 0.9  # inches: side columns, arrows, names, boxes, lines
SOURCE, EXAMPLES, TARGET = "source\nanimation", "source\nexamples", "target\nexamples"


@dataclass(frozen=True)
class Step:
    """One thing that a method does. also: what enters here besides the step before."""

    does: str
    also: str = ""


@dataclass(frozen=True)
class Structure:
    """One method. given: what its first step starts from; all know both neutral heads."""

    name: str
    given: str
    steps: tuple[Step, ...]


STRUCTURES = (
    Structure(
        "LBS", SOURCE,
        (
            Step("find the weights with which\nthe source's examples blend\nto its expression", EXAMPLES),
            Step("blend the target's examples\nwith the same weights", TARGET),
        ),
    ),
    Structure(
        "ALM", SOURCE,
        (
            Step("find weights for each\npatch, alike in\nneighbours", EXAMPLES),
            Step("blend the patches\nof the target's\nexamples", TARGET),
            Step("fit the target's own\nskin model, bound to\nits skull"),
        ),
    ),
    Structure(
        "EBFR", SOURCE,
        (
            Step("carry the animation over\nby deformation transfer:\na first guess"),
            Step("correct it until its frames,\nblended, give the target's\nexamples", TARGET),
        ),
    ),
    Structure(
        "DT", SOURCE,
        (
            Step("measure how each triangle\nof the source deforms"),
            Step("find the vertices of the target\nwhose triangles deform alike"),
        ),
    ),
    Structure(
        "ADT", SOURCE,
        (
            Step("simulate backwards:\nthe source's muscles,\ntissue and jaw"),
            Step("put them on the\nanatomy of the\ntarget"),
            Step("simulate forwards:\nthe target's skin"),
        ),
    ),
    Structure(
        "AnaConDaR", SOURCE,
        (
            Step("find weights\nfor each\npatch", EXAMPLES),
            Step("blend patches\nof the target's\nexamples", TARGET),
            Step("add what the\nexamples miss,\ncarried by ADT", SOURCE),
            Step("simulate the\ntarget's tissue\nand jaw"),
        ),
    ),
)  # fmt: skip


def structure_figure(path: Path, structures: Sequence[Structure] = STRUCTURES) -> None:
    """Write the diagram as SVG: a line for each method, from left to right."""
    height = _ROW * len(structures)
    with canvas(path, WIDTH, height) as figure:
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, WIDTH), ylim=(height, 0))  # inches, downwards
        axes.axis("off")
        for i, structure in enumerate(structures):
            draw(axes, structure, _ROW * i)


def draw(axes: Axes, structure: Structure, top: float) -> list[tuple[FancyBboxPatch, Text]]:
    """One line of the diagram, `top` inches from above; returns its boxes with their words."""
    if top > 0:
        axes.axhline(top, color="#dddddd", lw=0.5)
    axes.text(0.03, top + 0.15, structure.name, fontsize=8.5, fontweight="bold", va="center")
    y, count = top + _TOP + 0.06, len(structure.steps)
    width = (WIDTH - 0.06 - 2 * _SIDE - (count + 1) * _GAP) / count
    drawn = [_box(axes, 0.03, y, _SIDE, _BOX, structure.given, _GIVEN)]
    x = 0.03 + _SIDE
    for i, step in enumerate(structure.steps, start=1):
        _arrow(axes, (x, y + _BOX / 2), (x + _GAP, y + _BOX / 2))
        x += _GAP
        drawn.append(_box(axes, x, y, width, _BOX, step.does, _STEP))
        if step.also:
            wide = 0.95
            above = top + 0.06
            drawn.append(_box(axes, x + (width - wide) / 2, above, wide, 0.16, step.also.replace("\n", " "), _GIVEN))
            _arrow(axes, (x + width / 2, above + 0.16), (x + width / 2, y))
        axes.text(x + 0.04, y + 0.09, str(i), fontsize=5.5, fontweight="bold", color=_LINE, va="center")
        x += width
    _arrow(axes, (x, y + _BOX / 2), (x + _GAP, y + _BOX / 2))
    drawn.append(_box(axes, x + _GAP, y, _SIDE, _BOX, "target\nanimation", _RESULT))
    return drawn


def _box(
    axes: Axes, x: float, y: float, width: float, height: float, words: str, color: str
) -> tuple[FancyBboxPatch, Text]:
    box = FancyBboxPatch(
        (x, y), width, height, boxstyle="round,pad=0,rounding_size=0.04", facecolor=color, edgecolor=_LINE, lw=0.6
    )
    axes.add_patch(box)
    text = axes.text(
        x + width / 2, y + height / 2, words, ha="center", va="center", fontsize=6.3, linespacing=1.15
    )  # fmt: skip
    return box, text


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.add_patch(
        FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=7, color=_LINE, lw=0.9, shrinkA=0, shrinkB=0)
    )
