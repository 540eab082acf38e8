"""Renders the pictures of docs/regions.md: every region, loop and landmark of the MakeHuman head.

python docs/regions_figures.py [wheel]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from reports.camera import Camera, look
from reports.labels import labelled
from reports.render import Image, draw_lines, draw_points, render_mesh, visible
from retarget.types import FloatArray, IntArray, Regions
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head

FOLDER = Path(__file__).parent / "images"
SKIN, LEFT, RIGHT = (0.87, 0.82, 0.78), (0.16, 0.42, 0.72), (0.85, 0.42, 0.10)
FRONT, THREE_QUARTER, SIDE = (0.0, 4.0), (42.0, 6.0), (90.0, 0.0)  # turn and height of the camera, degrees
SIZE = (520, 620)
DPI = 100


@dataclass(frozen=True)
class Panel:
    """One picture of regions: the first in blue, the second in orange; `frame` names the region it is cropped to."""

    names: tuple[str, ...]
    view: tuple[float, float] = FRONT
    frame: str = ""


WHOLE = (
    Panel(("head",), THREE_QUARTER),
    Panel(("face",)),
    Panel(("scalp",), SIDE),
    Panel(("neck",), SIDE),
    Panel(("ear_left", "ear_right"), FRONT),
    Panel(("cranium",), THREE_QUARTER),
    Panel(("cranium_skin",), THREE_QUARTER),
    Panel(("jaw_skin",), (42.0, -15.0)),
)
PARTS = (
    Panel(("brow_left", "brow_right"), FRONT, "face"),
    Panel(("eye_left", "eye_right"), FRONT, "face"),
    Panel(("nose",), (30.0, 0.0), "face"),
    Panel(("cheek_left", "cheek_right"), (30.0, 0.0), "face"),
    Panel(("jaw",), (30.0, -12.0), "face"),
    Panel(("lips",), FRONT, "lips"),
    Panel(("upper_lip", "lower_lip"), FRONT, "lips"),
)


def main(arguments: list[str]) -> None:
    head, targets = load_head(wheel=Path(arguments[0]) if arguments else None)
    regions = load_regions()
    FOLDER.mkdir(exist_ok=True)
    _grid("regions_whole.png", [(_title(p.names), _region(head, regions, p)) for p in WHOLE])
    _grid("regions_parts.png", [(_title(p.names), _region(head, regions, p)) for p in PARTS])
    _grid("regions_loops.png", _loops(head, regions), columns=3)
    _grid("regions_supplementary.png", _supplementary(head, regions))
    sampler = IdentitySampler(head, targets, regions)
    for name, vertices in (("base", head.vertices), ("man", sampler(0).vertices), ("woman", sampler(1).vertices)):
        _landmarks(f"landmarks_anatomy_{name}.png", vertices, head.faces, regions)
        _ibug(f"landmarks_ibug_{name}.png", vertices, head.faces, regions)


def _title(names: Sequence[str]) -> str:
    return " (blue)\n".join(names) + (" (orange)" if len(names) > 1 else "")


def _camera(vertices: FloatArray, view: tuple[float, float], margin: float = 0.03) -> Camera:
    return look(vertices, SIZE, *view, margin=margin)


def _above_neck(vertices: FloatArray, regions: Regions) -> FloatArray:
    """The head without the rim of the neck, to aim cameras at."""
    return vertices[np.setdiff1d(regions.vertices["head"], regions.vertices["neck_boundary"])]


def _region(head: BaseHead, regions: Regions, panel: Panel) -> Image:
    colors = np.tile(SKIN, (len(head.vertices), 1))
    for name, color in zip(panel.names, (LEFT, RIGHT), strict=False):
        colors[regions.vertices[name]] = color
    aim = head.vertices[regions.vertices[panel.frame]] if panel.frame else _above_neck(head.vertices, regions)
    camera = _camera(aim, panel.view, 0.12 if panel.frame not in ("", "face") else 0.03)
    return render_mesh(head.vertices, head.faces, camera, SIZE, vertex_colors=colors)


def _loops(head: BaseHead, regions: Regions) -> list[tuple[str, Image]]:
    def picture(names: Sequence[str], frame: str, view: tuple[float, float], margin: float = 0.12) -> Image:
        aim = head.vertices[regions.vertices[frame]] if frame else head.vertices
        camera = _camera(aim, view, margin)
        image = render_mesh(head.vertices, head.faces, camera, SIZE, color=SKIN)
        for name, color in zip(names, (LEFT, RIGHT), strict=False):
            points = head.vertices[regions.loops[name]]
            shown = visible(points, head.vertices, head.faces, camera)
            pixels = camera.project(points, SIZE)
            image = draw_points(draw_lines(image, pixels, color, 2.0, shown=shown), pixels[shown], color, 2.5, None)
        return image

    def dots(names: Sequence[str]) -> Image:
        camera = _camera(head.vertices[regions.loops["lid_margin_left"]], (12.0, 0.0), 0.06)
        image = render_mesh(head.vertices, head.faces, camera, SIZE, color=SKIN)
        for name, color in zip(names, (LEFT, RIGHT), strict=True):
            image = draw_points(image, camera.project(head.vertices[regions.vertices[name]], SIZE), color, 5.0)
        return image

    lips, lids = ("lip_contour", "lip_inner"), ("lid_margin_upper_left", "lid_margin_lower_left")
    left, right = (("eye_socket" + side, "lid_margin" + side) for side in ("_left", "_right"))
    return [
        (_title(lips), picture(lips, "lips", FRONT)),
        ("the same, from the left", picture(lips, "lips", (55.0, 0.0))),
        (_title(left), picture(left, "eye_left", (12.0, 0.0))),
        (_title(right), picture(right, "eye_right", (-12.0, 0.0))),
        (_title(lids), dots(lids)),
        ("neck, neck_boundary", picture(("neck",), "", THREE_QUARTER, 0.03)),
    ]


def _supplementary(head: BaseHead, regions: Regions) -> list[tuple[str, Image]]:
    camera = _camera(head.vertices[regions.vertices["eye_left"]], (12.0, 0.0), 0.12)

    def patch(name: str) -> Image:
        triangles = regions.patches[name]
        lids = np.isin(head.faces, regions.vertices["eye_left"]).all(axis=1)
        faces = np.concatenate([head.faces[~lids] if name.startswith("eye_socket") else head.faces, triangles])
        # vertices of their own, so that the patch has one colour up to its edge
        vertices = np.concatenate([head.vertices, head.vertices[triangles].reshape(-1, 3)])
        faces[-len(triangles) :] = len(head.vertices) + np.arange(3 * len(triangles)).reshape(-1, 3)
        colors = np.tile(SKIN, (len(vertices), 1))
        colors[len(head.vertices) :] = (0.55, 0.70, 0.86)
        image = render_mesh(vertices, faces, camera, SIZE, vertex_colors=colors)
        for triangle in triangles:
            image = draw_lines(image, camera.project(head.vertices[triangle], SIZE), LEFT, 1.5)
        return image

    def ring(name: str) -> Image:
        colors = np.tile(SKIN, (len(head.vertices), 1))
        colors[np.unique(head.faces[regions.triangles[name]])] = LEFT
        return render_mesh(head.vertices, head.faces, camera, SIZE, vertex_colors=colors)

    interior = head.faces[np.isin(head.faces, regions.vertices["interior"]).all(axis=1)][:, ::-1]
    inside = _camera(head.vertices[regions.vertices["interior"]], THREE_QUARTER, 0.06)
    return [
        ("patches: eye_opening_left", patch("eye_opening_left")),
        ("patches: eye_socket_left", patch("eye_socket_left")),
        ("triangles: eye_socket_left", ring("eye_socket_left")),
        ("interior, by itself", render_mesh(head.vertices, interior, inside, SIZE, color=SKIN)),
    ]


def _grid(name: str, panels: Sequence[tuple[str, Image]], columns: int = 4) -> None:
    rows = -(-len(panels) // columns)
    width = min(columns, len(panels)) * 3.6
    figure, axes = plt.subplots(
        rows, columns, figsize=(width, rows * 4.9), dpi=DPI, squeeze=False, layout="constrained"
    )
    for axis in axes.flat:
        axis.axis("off")
    for axis, (title, image) in zip(axes.flat, panels, strict=False):
        axis.imshow(image)
        axis.text(0.5, -0.02, title, transform=axis.transAxes, ha="center", va="top", fontsize=12)
    _save(figure, name)


def _landmarks(name: str, vertices: FloatArray, faces: IntArray, regions: Regions) -> None:
    """Anatomical landmarks from the front (the left half of those that come in pairs, and the midline) and the side."""
    points = {k: vertices[v] for k, v in regions.landmarks.items() if not k.startswith(("ibug", "stomion"))}
    twins = {"prosthion": "labrale_superius", "infradentale": "labrale_inferius"}  # one vertex, two names
    stomion = vertices[[regions.landmarks["stomion_upper"], regions.landmarks["stomion_lower"]]]
    points["stomion_upper, _lower"] = stomion.mean(axis=0)
    points = {f"{k} = {twins[k]}" if k in twins else k: p for k, p in points.items() if k not in twins.values()}
    size = (900, 1080)
    figure, axes = plt.subplots(1, 2, figsize=(17, 8.4), dpi=DPI, layout="constrained")
    aim = vertices[np.setdiff1d(regions.vertices["face"], regions.vertices["scalp"])]
    for axis, view in zip(axes, (FRONT, (80.0, 0.0)), strict=True):
        camera = look(np.concatenate([aim, vertices[regions.vertices["ears"]]]), size, *view)
        image = render_mesh(vertices, faces, camera, size, color=SKIN)
        lateral = view != FRONT
        kept = {k: p for k, p in points.items() if k.endswith("_left") or (not k.endswith("_right") and not lateral)}
        if lateral:
            kept["condyle_left (inside)"] = regions.points["condyle_left"](vertices)
        labelled(axis, image, camera, size, kept)
    _save(figure, name)


def _ibug(name: str, vertices: FloatArray, faces: IntArray, regions: Regions) -> None:
    """The 51 landmarks of the landmark-guided transfer with their numbers: the face, then eye and mouth enlarged."""
    indices = np.array([regions.landmarks[f"ibug_{i:02d}"] for i in range(51)])
    size = (900, 1000)
    figure, axes = plt.subplots(1, 3, figsize=(20, 7.8), dpi=DPI, layout="constrained")
    aims = (
        (indices, FRONT, 0.10),
        (regions.vertices["eye_left"], (10.0, 0.0), 0.05),
        (np.concatenate([regions.vertices["lips"], indices[14:19]]), FRONT, 0.08),
    )
    for axis, (aim, view, margin) in zip(axes, aims, strict=True):
        camera = look(vertices[aim], size, *view, margin=margin)
        axis.imshow(render_mesh(vertices, faces, camera, size, color=SKIN))
        axis.axis("off")
        for i, (x, y) in enumerate(camera.project(vertices[indices], size)):
            if 0 < x < size[0] and 0 < y < size[1]:
                axis.plot(x, y, "o", markersize=4, color="#c1121f", markeredgecolor="white", markeredgewidth=0.5)
                below = i in (15, 16, 17, 29, 30, 23, 24, 38, 39, 40, 41, 42, 48, 49, 50, 14, 18)
                offset = (0, -13) if below else (0, 6)
                axis.annotate(str(i), (x, y), offset, textcoords="offset points", ha="center", fontsize=10)
        axis.set_xlim(0, size[0])
        axis.set_ylim(size[1], 0)
    _save(figure, name)


def _save(figure: plt.Figure, name: str) -> None:
    figure.savefig(FOLDER / name, bbox_inches="tight", metadata={"Software": None}, pil_kwargs={"optimize": True})
    plt.close(figure)


if __name__ == "__main__":
    main(sys.argv[1:])
