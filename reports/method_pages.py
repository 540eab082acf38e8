"""Figs 1 and 7 of the paper: the patches on a head, and the structure of the methods as a diagram."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from reports.camera import look
from reports.figures import WIDTH, canvas
from reports.heads import RAISE, TURN, framed
from reports.load import StudyResults
from reports.render import render_mesh, write_image
from retarget.check import InvalidInput
from retarget.geometry.patches import contiguous_patches
from retarget.types import IntArray

SIZE = (420, 520)  # pixels
PATCHES = 80  # of the paper's Fig. 1
_TINTS = ("#7fb3d5", "#f2c078", "#8ccfb5", "#e3a5c7", "#d9d27a", "#b9a3d3", "#e69a8d", "#c2c2c2")
_GIVEN, _MADE, _LINE = "#dbe7f3", "#fbe3c2", "#555555"
_PLACES = {"SE": (0.24, 0.68), "TE": (0.76, 0.68), "S": (0.24, 0.2), "T": (0.76, 0.2)}
_NAMES = {"SE": "source\nexamples", "TE": "target\nexamples", "S": "source\nanimation", "T": "target\nanimation"}


@dataclass(frozen=True)
class Structure:
    """One method of the diagram. arrows: (from, to, words); made: what the method forms, the rest is given."""

    name: str
    unknowns: str
    given: tuple[str, ...]
    made: tuple[str, ...]
    arrows: tuple[tuple[str, str, str], ...]


STRUCTURES = (
    Structure(
        "LBS", "weights of each expression",
        ("SE", "TE", "S"), ("T",), (("SE", "S", "fit weights"), ("TE", "T", "blend")),
    ),
    Structure(
        "ALM", "weights of each patch, then patches on the skull",
        ("SE", "TE", "S"), ("T",), (("SE", "S", "fit, by patch"), ("TE", "T", "blend, skull")),
    ),
    Structure(
        "EBFR", "the animation, weights of each example",
        ("TE", "S"), ("T",), (("S", "T", "DT as a prior"), ("T", "TE", "explain")),
    ),
    Structure("DT", "vertices of each expression", ("S",), ("T",), (("S", "T", "gradients"),)),
    Structure("ADT", "tissue of the source, then of the target", ("S",), ("T",), (("S", "T", "tissue, bones"),)),
    Structure(
        "AnaConDaR", "weights of each patch, tissue",
        ("TE", "S"), ("SE", "T"),
        (("TE", "SE", "embed"), ("SE", "S", "fit, by patch"), ("TE", "T", "blend"), ("S", "T", "ADT of the rest")),
    ),
)  # fmt: skip


def structure_figure(path: Path, structures: Sequence[Structure] = STRUCTURES) -> None:
    """Write the diagram as SVG."""
    columns = 3
    lines = -(-len(structures) // columns)
    with canvas(path, WIDTH, 1.75 * lines) as figure:
        grid = figure.subplots(lines, columns, squeeze=False)
        figure.subplots_adjust(left=0.005, right=0.995, bottom=0.01, top=0.99, wspace=0.04, hspace=0.06)
        for axes in grid.flat:
            axes.axis("off")
        for axes, structure in zip(grid.flat, structures, strict=False):
            _draw(axes, structure)


def _draw(axes: Axes, structure: Structure) -> None:
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.text(0.5, 0.98, structure.name, ha="center", va="top", fontsize=8.5, fontweight="bold")
    axes.text(0.5, 0.88, structure.unknowns, ha="center", va="top", fontsize=5.8, color=_LINE)
    width, height = 0.27, 0.2
    for name in (*structure.given, *structure.made):
        x, y = _PLACES[name]
        box = FancyBboxPatch(
            (x - width / 2, y - height / 2), width, height, boxstyle="round,pad=0.005,rounding_size=0.03",
            facecolor=_MADE if name in structure.made else _GIVEN, edgecolor=_LINE, lw=0.6,
        )  # fmt: skip
        axes.add_patch(box)
        axes.text(x, y, _NAMES[name], ha="center", va="center", fontsize=6.2, linespacing=1.1)
    for start, end, words in structure.arrows:
        (x0, y0), (x1, y1) = _PLACES[start], _PLACES[end]
        level = np.isclose(y0, y1)
        gap = np.array([width / 2 + 0.02, 0]) if level else np.array([0, height / 2 + 0.02])
        way = np.sign([x1 - x0, y1 - y0]) * gap
        axes.add_patch(
            FancyArrowPatch(
                (x0 + way[0], y0 + way[1]),
                (x1 - way[0], y1 - way[1]),
                arrowstyle="-|>",
                mutation_scale=7,
                color=_LINE,
                lw=0.9,
                shrinkA=0,
                shrinkB=0,
            )
        )
        x, y = (x0 + x1) / 2, (y0 + y1) / 2
        if level:
            axes.text(x, y + 0.125, words, ha="center", va="bottom", fontsize=5.6)
        else:
            axes.text(x + (-0.02 if x < 0.5 else 0.02), y, words, ha="right" if x < 0.5 else "left", va="center",
                      fontsize=5.6)  # fmt: skip


def patch_figure(study: StudyResults, folder: Path, name: str) -> dict[str, object] | None:
    """Two views of the patches on the target of the first kept cell: {files, count, vertices}; None without frames.

    The patches are those of the study's patchwise blendshapes, or 80; they follow from faces alone.
    """
    cells = study.figure_cells
    if not cells:
        return None
    counts = {m.name: m.settings.get("patch_count") for m in study.methods}
    count = next((counts[m] for m in ("anacondar", "plbs") if isinstance(counts.get(m), int)), PATCHES)
    frames = cells[0].frames
    skin = frames.target_neutral.astype(np.float64)
    try:
        patches = contiguous_patches(frames.faces, len(skin), int(count or PATCHES))
    except InvalidInput:  # a mesh in many pieces, or a coarse one
        return None
    colors = np.array([to_rgb(tint) for tint in _TINTS])[_tints(frames.faces, patches, len(skin))]
    files = []
    for i, turn in enumerate((0.0, TURN + 16.0)):
        camera = look(framed(frames), SIZE, turn=turn, raise_=RAISE, margin=0.03)
        file = f"{name}-{i}.jpg"
        write_image(folder / file, render_mesh(skin, frames.faces, camera, SIZE, vertex_colors=colors))
        files.append(file)
    return {"files": files, "count": len(patches), "vertices": len(skin)}


def _tints(faces: IntArray, patches: Sequence[IntArray], count: int) -> IntArray:
    """(n,) index of a tint for each vertex: neighbouring patches differ, as long as the tints last."""
    of = np.empty(count, dtype=np.int64)
    for i, patch in enumerate(patches):
        of[patch] = i
    edges = of[faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)]
    pairs = np.unique(np.concatenate([edges, edges[:, ::-1]]), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    tint = np.full(len(patches), -1)
    for i in range(len(patches)):
        taken = set(tint[pairs[pairs[:, 0] == i, 1]].tolist())
        free = [t for t in range(len(_TINTS)) if t not in taken]
        tint[i] = min(free, key=lambda t: (np.count_nonzero(tint == t), t), default=i % len(_TINTS))
    return np.asarray(tint[of], dtype=np.int64)
