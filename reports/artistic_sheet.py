"""The page of the study of artistic control: each edit beside the result without it, and where it moves the skin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reports.camera import Camera, look
from reports.heads import nice
from reports.render import Image, draw_lines, draw_points, render_mesh, visible, write_image
from reports.sheet import Picture, PictureRow, Pictures, Table, write_sheet
from reports.text import number, seconds
from retarget.types import FloatArray, IntArray, Pair

SIZE = (640, 470)  # pixels
TARGET = "#c1121f"
FRAMED = ("brows", "nose", "cheeks", "lips")  # what the pictures hold
VIEW = {"turn": 22.0, "raise_": 3.0}


@dataclass(frozen=True)
class Panel:
    """One edit. numbers: its line of the table, without the title."""

    title: str
    edits: Mapping[str, Any]
    numbers: Mapping[str, Any]
    pair: Pair
    before: FloatArray  # (n, 3) mm, without the edit
    after: FloatArray  # (n, 3) mm
    control: IntArray  # control points
    wanted: FloatArray  # (k, 3) mm, the contour that they ask for; (0, 3) without


def write_artistic_sheet(path: Path, title: str, description: str, panels: Sequence[Panel], work: Path) -> None:
    """Write the PDF; pictures go into the folder `work`."""
    rows = tuple(_row(panel, f"edit{i}", work) for i, panel in enumerate(panels))
    heads = "without the edit", "with it", "displacement by the edit"
    caption = (
        "Red: the lip contour that control points (white) ask for, on the result without the edit. Each row has its "
        "own scale of displacements."
    )
    blocks: list[Pictures | Table] = [Pictures(heads, (1.0, 1.0, 1.0), rows, caption), _table(panels)]
    write_sheet(path, title, description, blocks, work)


def _row(panel: Panel, name: str, work: Path) -> PictureRow:
    faces, regions = panel.pair.faces, panel.pair.regions
    seen = regions.vertices.get("face", np.arange(len(panel.before)))
    framed = np.concatenate([regions.vertices[name] for name in FRAMED if name in regions.vertices] or [seen])
    framed = np.append(framed, [regions.landmarks[name] for name in ("menton",) if name in regions.landmarks])
    framed = framed.astype(np.int64)
    camera = look(np.concatenate([panel.before[framed], panel.after[framed]]), SIZE, margin=0.0, **VIEW)
    moved = np.linalg.norm(panel.after - panel.before, axis=1)
    limit = nice(float(np.quantile(moved[seen], 0.99)))
    before = render_mesh(panel.before, faces, camera, SIZE)
    after = render_mesh(panel.after, faces, camera, SIZE)
    if len(panel.wanted):
        before = _with_target(before, panel, panel.before, camera)
        after = _with_target(after, panel, panel.after, camera)
    map_ = render_mesh(panel.after, faces, camera, SIZE, vertex_values=moved, limits=(0.0, limit))
    for when, image in (("before", before), ("after", after), ("map", map_)):
        write_image(work / f"{name}-{when}.jpg", image)
    pictures = (
        Picture(f"{name}-before.jpg"),
        Picture(f"{name}-after.jpg"),
        Picture(f"{name}-map.jpg", "", number(limit, 2).rstrip("0").rstrip(".")),
    )
    return PictureRow(pictures, f"{panel.title}: {_words(panel.edits)}")


def _with_target(image: Image, panel: Panel, skin: FloatArray, camera: Camera) -> Image:
    contour = np.asarray(panel.pair.regions.loops["lip_contour"], dtype=np.int64)
    shown = visible(skin[contour], skin, panel.pair.faces, camera, lift=1.5)
    image = draw_lines(image, camera.project(panel.wanted, SIZE), TARGET, 2.4, shown=shown)
    at = [int(np.flatnonzero(contour == v)[0]) for v in panel.control if v in contour and shown[contour == v][0]]
    return draw_points(image, camera.project(panel.wanted[at], SIZE), "white", 6.0, edge=TARGET) if at else image


def _words(edits: Mapping[str, Any]) -> str:
    """The edit as a person would say it, in short."""
    parts = []
    for name, value in edits.items():
        if name == "gravity":
            parts.append("(" + ", ".join(f"{float(g):g}" for g in value) + ") m/s²")
        elif name in ("stiffness", "patch_weights"):
            word = "stiffness" if name == "stiffness" else "strength"
            parts.append(", ".join(f"{word} of {region} × {factor:g}" for region, factor in value.items()))
        else:
            moved = sum(bool(np.any(np.asarray(v, dtype=float))) for v in value.values())
            parts.append(f"{moved} of {len(value)} control points moved")
    return "; ".join(parts)


def _table(panels: Sequence[Panel]) -> Table:
    heads = ("edit", "mean mm", "largest mm", "share", "cranium mm", "contour mm", "status", "time")
    rows = []
    for panel in panels:
        n = panel.numbers
        arrives = f"{number(n['contour_before_mm'], 2)} to {number(n['contour_after_mm'], 3)}"
        rows.append(
            (
                panel.title,
                number(n["moved_mean_mm"], 3),
                number(n["moved_max_mm"], 2),
                f"{100 * n['moved_share']:.0f} %",
                number(n["cranium_max_mm"], 3),
                arrives if len(panel.wanted) else "",
                str(n["status"]).replace("_", " "),
                seconds(n["seconds"]),
            )
        )
    caption = (
        "Displacement by the edit on the visible head, the share of it that moves by more than 0.1 mm, and the largest "
        "on the cranium. Contour: mean distance from the contour that is asked for, before and after. Times are of the "
        "whole method, with the factors that an edit needs."
    )
    return Table(heads, tuple(rows), caption)
