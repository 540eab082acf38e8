"""Pictures of docs/anatomy.md: `python docs/anatomy_figures.py`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch

from reports.camera import Camera, look
from reports.render import Image, draw_lines, render_mesh, visible, write_image
from retarget.anatomy.boundary import boundary_faces
from retarget.anatomy.closed import cap
from retarget.anatomy.depths import landmark_depths, load_depths
from retarget.anatomy.head import HeadTemplate
from retarget.anatomy.skull import build_skull
from retarget.anatomy.store import load_template
from retarget.types import FloatArray, IntArray
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head

IMAGES = Path(__file__).parent / "images"
SKIN, SOFT, MUSCLE, BONE, JAW, FREE = "#dcc3b0", "#e8c09a", "#a8433f", "#e3d9c3", "#4f8fc0", "#8a8a86"
BLUE, ORANGE = "#2a6bb8", "#d96b1a"
SIZE = (460, 560)
VIEWS = ((38.0, 4.0), (90.0, 0.0))  # turn and height of the camera, degrees
DPI = 100
LIFT = np.array([0.0, 0.0, 6.0])  # mm


def main() -> None:
    base, _ = load_head()
    step = subdivide(base.faces, len(base.vertices))
    head = load_template(step.faces, step.regions(load_regions()), "paper")
    skull(base)
    surfaces(head)
    supplementary(head)
    sections([load_template(step.faces, head.regions, "coarse"), head])


def skull(base: BaseHead) -> None:
    """The neutral head above the skull that its depths make."""
    regions = load_regions()
    vertices, faces = cap("head", base.vertices, base.faces)
    bone = build_skull(vertices, faces, regions, landmark_depths(load_depths(), regions))
    cameras = [look(vertices, SIZE, *view) for view in ((0.0, 4.0), *VIEWS)]
    rows = [
        np.hstack([render_mesh(v, f, camera, SIZE, color=color) for camera in cameras])
        for v, f, color in ((vertices, faces, SKIN), (bone.vertices, bone.faces, BONE))
    ]
    write_image(IMAGES / "anatomy_skull.png", np.vstack(rows))


def surfaces(head: HeadTemplate) -> None:
    """Fig. 3 of the paper: soft tissue, muscle, and the skull with its cranium and jaw."""
    rows = []
    for view in VIEWS:
        camera = look(head.skin, SIZE, *view)
        tissue = [
            render_mesh(head.vertices, boundary_faces(head.tets[chosen])[0], camera, SIZE, color=color)
            for chosen, color in ((~head.muscle, SOFT), (head.muscle, MUSCLE))
        ]
        rows.append(np.hstack([*tissue, _bones(head, camera)]))
    titles = ["soft tissue", "muscle", "skull: cranium, jaw (blue), free (grey)"]
    _save(np.vstack(rows), titles, "anatomy_surfaces.png")


def _bones(head: HeadTemplate, camera: Camera) -> Image:
    colors = np.tile(to_rgb(FREE), (len(head.vertices), 1))
    colors[head.cranium], colors[head.jaw] = to_rgb(BONE), to_rgb(JAW)
    return render_mesh(head.vertices, head.skull_faces, camera, SIZE, vertex_colors=colors)


def supplementary(head: HeadTemplate) -> None:
    """Fig. 4 of the paper: eye sockets, eye openings, lip contour, and the skin that tells of cranium and jaw."""
    parts = head.regions
    camera = look(head.skin[parts.vertices["face"]], SIZE, 0.0, 2.0)
    pictures = []
    for name in ("eye_socket", "eye_opening"):
        pictures.append(_patched(head, [f"{name}_left", f"{name}_right"], camera))
    contour = head.skin[parts.loops["lip_contour"]]
    plain = render_mesh(head.skin, head.faces, camera, SIZE, color=SKIN)
    shown = visible(contour, head.skin, head.faces, camera)
    pictures.append(draw_lines(plain, camera.project(contour, SIZE), BLUE, 3.0, shown=shown))
    colors = np.tile(to_rgb(SKIN), (len(head.skin), 1))
    colors[parts.vertices["cranium_skin"]] = to_rgb(ORANGE)
    colors[parts.vertices["jaw_skin"]] = to_rgb(BLUE)
    pictures.append(render_mesh(head.skin, head.faces, look(head.skin, SIZE, 38.0, 2.0), SIZE, vertex_colors=colors))
    titles = ["eye sockets", "eyelids", "lip contour", "skin of cranium (orange) and jaw (blue)"]
    _save(np.hstack(pictures), titles, "anatomy_supplementary.png")


def _patched(head: HeadTemplate, names: list[str], camera: Camera) -> Image:
    """The skin with supplementary triangles before it, left one in blue, right one in orange."""
    vertices, faces, colors = [head.skin], [head.faces], [np.tile(to_rgb(SKIN), (len(head.skin), 1))]
    for name, color in zip(names, (BLUE, ORANGE), strict=True):
        patch = head.regions.patches[name]
        faces.append(patch + len(head.skin) * len(vertices))
        vertices.append(head.skin + LIFT)  # towards the viewer, so that the skin between does not hide it
        colors.append(np.tile(to_rgb(color), (len(head.skin), 1)))
    together, triangles = np.vstack(vertices), np.vstack(faces)
    picture = render_mesh(together, triangles, camera, SIZE, vertex_colors=np.vstack(colors))
    for k, name in enumerate(names, start=1):
        for triangle in head.regions.patches[name]:
            pixels = camera.project(vertices[k][triangle], SIZE)
            picture = draw_lines(picture, pixels, "white", 0.8)
    return picture


def sections(heads: list[HeadTemplate]) -> None:
    """Cuts through the tetrahedra, a row for each size."""
    figure, rows = plt.subplots(len(heads), 4, figsize=(22, 7.2 * len(heads)), dpi=DPI, layout="constrained")
    for head, row in zip(heads, rows, strict=True):
        _sections(head, row)
        row[0].text(0.5, -0.02, f"{len(head.tets):,} tets", ha="center", transform=row[0].transAxes, fontsize=15)
    legend = [Patch(color=SOFT, label="soft tissue"), Patch(color=MUSCLE, label="muscle")]
    rows[0, 0].legend(handles=legend, loc="lower right", frameon=False, fontsize=15)
    figure.savefig(IMAGES / "anatomy_sections.png", metadata={"Software": None}, dpi=75)
    plt.close(figure)


def _sections(head: HeadTemplate, axes: Sequence[Axes]) -> None:
    mark = head.skin[head.regions.landmarks["cheilion_left"]]
    eye = head.skin[head.regions.landmarks["supraorbital_left"]]
    cuts = (
        ("middle", 0, 1.0, None),
        ("through an eye", 0, float(eye[0]), None),
        ("above the mouth", 1, float(mark[1]) + 14.0, None),
        ("middle, the mouth enlarged", 0, 1.0, 36.0),
    )
    for axis, (title, normal, at, frame) in zip(axes, cuts, strict=True):
        polygons, colors = _cut(head, normal, at)
        axis.add_collection(PolyCollection(polygons, facecolors=colors, edgecolors="0.15", linewidths=0.25))
        axis.autoscale()
        _frame(axis, title)
        if frame is not None:
            axis.set_ylim(mark[1] - frame, mark[1] + frame)
            axis.set_xlim(mark[2] - 0.6 * frame, mark[2] + frame)


def _cut(head: HeadTemplate, normal: int, at: float) -> tuple[list[FloatArray], list[str]]:
    """Polygons in the plane where coordinate `normal` is `at` mm, with their colours."""
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: head.tets}, head.vertices)
    grid["muscle"] = head.muscle.astype(float)
    origin = np.zeros(3)
    origin[normal] = at
    cut = grid.slice(normal=np.eye(3)[normal], origin=origin, generate_triangles=True)
    across = [2, 1] if normal == 0 else [0, 2]
    faces: IntArray = cut.regular_faces
    return list(np.asarray(cut.points)[faces][..., across]), [MUSCLE if m else SOFT for m in cut["muscle"]]


def _frame(axis: Axes, title: str) -> None:
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=17)
    axis.axis("off")


def _save(picture: Image, titles: list[str], name: str) -> None:
    """Write a row of pictures under their titles."""
    figure = plt.figure(figsize=(picture.shape[1] / DPI, picture.shape[0] / DPI + 0.4), dpi=DPI)
    height = picture.shape[0] / DPI / (picture.shape[0] / DPI + 0.4)
    axis = figure.add_axes((0, 0, 1, height))
    axis.imshow(picture, aspect="auto")
    axis.axis("off")
    for i, title in enumerate(titles):
        figure.text((i + 0.5) / len(titles), 0.5 * (1 + height), title, ha="center", va="center", fontsize=14)
    figure.savefig(IMAGES / name, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    main()
