"""One picture of all regions, loops and landmarks of a head, for a person to check after a transfer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch

from reports.camera import Camera, look
from reports.labels import labelled
from reports.render import SKIN, Image, draw_lines, draw_points, render_mesh, visible
from retarget.types import FloatArray, IntArray, Regions

COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#B8A800", "#6A3D9A")
PARTITION = ("scalp", "ears", "neck", "face")
PARTS = ("brows", "eyes", "nose", "cheeks", "jaw", "upper_lip", "lower_lip")
BONES = ("cranium_skin", "jaw_skin")
LOOPS = ("lip_contour", "lip_inner", "eye_socket_left", "lid_margin_left", "eye_socket_right", "lid_margin_right")
SIZE, WIDE = (560, 660), (900, 1040)
VIEWS = ((0.0, 0.0), (40.0, 4.0), (90.0, 0.0), (-40.0, 4.0))  # turn and height of the camera, degrees


def regions_sheet(path: Path | str, vertices: FloatArray, faces: IntArray, regions: Regions) -> None:
    """Write a PNG: sets on the whole head and the face, loops and patches enlarged, landmarks with their names.

    vertices (n, 3) mm, faces (f, 3). What a head lacks is left out.
    """
    parts = regions.vertices
    face = vertices[parts["face"]]
    whole = np.concatenate([vertices[parts[name]] for name in ("face", "scalp", "ears") if name in parts])
    figure = plt.figure(figsize=(24, 39), dpi=100, layout="constrained")
    grid = figure.add_gridspec(5, 1, height_ratios=(1, 1, 1, 1, 1.3))
    rows = [figure.add_subfigure(grid[i]) for i in range(5)]
    for row, (names, aim, title) in enumerate(
        ((PARTITION, whole, "sets of the head"), (PARTS, face, "sets of the face"))
    ):
        axes = rows[row].subplots(1, 4)
        for axis, view in zip(axes, VIEWS, strict=True):
            _show(axis, _sets(vertices, faces, regions, names, look(aim, SIZE, *view)))
        _legend(axes[0], [name for name in names if name in parts], title)

    axes = rows[2].subplots(1, 4)
    for axis, view in zip(axes[:2], ((0.0, 4.0), (50.0, 0.0)), strict=True):
        camera = look(vertices[parts["lips"]], SIZE, *view, margin=0.12)
        _show(axis, _loops(render_mesh(vertices, faces, camera, SIZE, color=SKIN), vertices, faces, regions, camera))
    for axis, side, turn in ((axes[2], "right", -12.0), (axes[3], "left", 12.0)):
        camera = look(vertices[parts[f"eye_{side}"]], SIZE, turn, 0.0, margin=0.1)
        _show(axis, _loops(render_mesh(vertices, faces, camera, SIZE, color=SKIN), vertices, faces, regions, camera))
    _legend(axes[0], [name for name in LOOPS if name in regions.loops], "loops, where they are seen")

    axes = rows[3].subplots(1, 4)
    camera = look(vertices[parts["eye_left"]], SIZE, 12.0, 0.0, margin=0.1)
    for axis, name in zip(axes[:2], ("eye_opening_left", "eye_socket_left"), strict=True):
        if name in regions.patches:
            _show(axis, _patch(vertices, faces, regions, name, camera))
        axis.set_title(f"patch {name}", fontsize=14)
    _show(axes[2], _sets(vertices, faces, regions, BONES, look(whole, SIZE, 40.0, 0.0)))
    _legend(axes[2], [name for name in BONES if name in parts], "skin that follows the bones")
    inside = faces[np.isin(faces, parts.get("interior", ())).all(axis=1)][:, ::-1]
    if len(inside):
        camera = look(vertices[np.unique(inside)], SIZE, 40.0, 4.0, margin=0.06)
        _show(axes[3], render_mesh(vertices, inside, camera, SIZE, color=SKIN))
    axes[3].set_title("interior, by itself", fontsize=14)

    axes = rows[4].subplots(1, 3)
    points = {n: vertices[v] for n, v in regions.landmarks.items() if not n.startswith("ibug")}
    for axis, view in zip(axes[:2], ((0.0, 4.0), (80.0, 0.0)), strict=True):
        lateral = view[0] > 45
        kept = {n: p for n, p in points.items() if n.endswith("_left") or not (lateral or n.endswith("_right"))}
        if lateral and "condyle_left" in regions.points:
            kept["condyle_left (inside)"] = regions.points["condyle_left"](vertices)
        camera = look(whole, WIDE, *view)
        labelled(axis, render_mesh(vertices, faces, camera, WIDE, color=SKIN), camera, WIDE, kept)
    _numbers(axes[2], vertices, faces, regions, look(face, WIDE, 0.0, 4.0))
    figure.savefig(path, metadata={"Software": None}, pil_kwargs={"optimize": True})
    plt.close(figure)


def _sets(vertices: FloatArray, faces: IntArray, regions: Regions, names: Sequence[str], camera: Camera) -> Image:
    colors = np.tile(to_rgb(SKIN), (len(vertices), 1))
    for name, color in zip((n for n in names if n in regions.vertices), COLORS, strict=False):
        colors[regions.vertices[name]] = 0.25 + 0.75 * np.array(to_rgb(color))
    return render_mesh(vertices, faces, camera, SIZE, vertex_colors=colors)


def _loops(image: Image, vertices: FloatArray, faces: IntArray, regions: Regions, camera: Camera) -> Image:
    for name, color in zip((n for n in LOOPS if n in regions.loops), COLORS, strict=False):
        points = vertices[regions.loops[name]]
        shown = visible(points, vertices, faces, camera)
        pixels = camera.project(points, SIZE)
        image = draw_points(draw_lines(image, pixels, color, 1.8, shown=shown), pixels[shown], color, 2.0, None)
    return image


def _patch(vertices: FloatArray, faces: IntArray, regions: Regions, name: str, camera: Camera) -> Image:
    triangles = regions.patches[name]
    lids = np.isin(faces, regions.vertices["eye_left"]).all(axis=1)
    kept = np.concatenate([faces[~lids] if name.startswith("eye_socket") else faces, triangles])
    # vertices of their own, so that the patch has one colour up to its edge
    doubled = np.concatenate([vertices, vertices[triangles].reshape(-1, 3)])
    kept[-len(triangles) :] = len(vertices) + np.arange(3 * len(triangles)).reshape(-1, 3)
    colors = np.tile(to_rgb(SKIN), (len(doubled), 1))
    colors[len(vertices) :] = (0.55, 0.70, 0.86)
    image = render_mesh(doubled, kept, camera, SIZE, vertex_colors=colors)
    for triangle in triangles:
        image = draw_lines(image, camera.project(vertices[triangle], SIZE), COLORS[0], 1.2)
    return image


def _numbers(axis: Axes, vertices: FloatArray, faces: IntArray, regions: Regions, camera: Camera) -> None:
    """The landmarks of iBUG with their numbers."""
    _show(axis, render_mesh(vertices, faces, camera, WIDE, color=SKIN))
    names = [name for name in regions.landmarks if name.startswith("ibug_")]
    if not names:
        return
    pixels = camera.project(vertices[[regions.landmarks[name] for name in names]], WIDE)
    for name, pixel in zip(names, pixels, strict=True):
        axis.plot(*pixel, "o", markersize=4, color="#c1121f", markeredgecolor="white", markeredgewidth=0.5)
        axis.annotate(name[5:], pixel, (0, 5), textcoords="offset points", ha="center", fontsize=8)
    axis.set_title("ibug_00 to ibug_50", fontsize=14)


def _show(axis: Axes, image: Image) -> None:
    axis.imshow(image)
    axis.axis("off")


def _legend(axis: Axes, names: Sequence[str], title: str) -> None:
    handles = [Patch(color=color, label=name) for name, color in zip(names, COLORS, strict=False)]
    axis.legend(handles=handles, loc="lower left", fontsize=11, framealpha=0.85)
    axis.set_title(title, fontsize=14, loc="left")
