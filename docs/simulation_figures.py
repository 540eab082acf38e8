"""The pictures of expressions and of the section in docs/simulation.md: `python docs/simulation_figures.py [size]`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from reports.camera import Camera, front, three_quarter
from reports.render import render_mesh, write_image
from retarget.anatomy.fit import fit_head
from retarget.anatomy.head import Head
from retarget.anatomy.store import load_template
from retarget.simulation.bones import size_ratio
from retarget.simulation.characteristics import FacialCharacteristics
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSimulation
from retarget.simulation.state import HeadState
from retarget.types import FloatArray, IntArray, Pair, Regions
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import personal_rig
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head

IMAGES = Path(__file__).parent / "images"
SOURCE, TARGET = 0, 3  # seeds
SIZE = (360, 400)
COLUMNS = (
    "source's expression",
    "inverse simulation\non the source's head",
    "forward simulation\non the target's head",
    "with facial characteristics\nand lip collisions",
)
SOFT, MUSCLE, INVERTED = "#f2d3bd", "#b5524a", "#111111"
CRANIUM, JAW, FREE = "#1d3557", "#2a9d8f", "#e9a800"
PLANES = {"median plane": 0.0, "40 mm to the left": 40.0}  # mm from stomion
PARTS = {"face": ("pronasale", 74.0), "eyes": ("nasion", 45.0), "mouth": ("stomion_upper", 28.0)}  # mm about a landmark
LEAST, MOST = 0.4, 2.0  # of the colours of det F

View = Callable[[FloatArray, tuple[int, int]], Camera]
EXPRESSIONS: dict[str, tuple[dict[str, float], str, View]] = {  # units, part of the face that is shown, and from where
    "smile": ({"mouthSmileLeft": 1, "mouthSmileRight": 1}, "face", three_quarter),
    "jaw drop": ({"jawOpen": 1}, "face", three_quarter),
    "blink": ({"eyeBlinkLeft": 1, "eyeBlinkRight": 1}, "eyes", front),
    "pucker": ({"mouthPucker": 1}, "mouth", three_quarter),
    "cheek puff": ({"cheekPuff": 1}, "face", three_quarter),
    "lips pressed\nand shrugged": (
        {"mouthPressLeft": 1, "mouthPressRight": 1, "mouthShrugLower": 1},
        "mouth",
        three_quarter,
    ),
}


def main(size: str = "paper") -> None:
    base, targets = load_head()
    sampler = IdentitySampler(base, targets, load_regions())
    people = [sampler(seed) for seed in (SOURCE, TARGET)]
    fine = subdivide(base.faces, len(base.vertices))
    template = load_template(fine.faces, fine.regions(load_regions()), size)
    source, target = (fit_head(template, fine(person.vertices)) for person in people)
    rig = dict(zip(SKIN_NAMES, fine(personal_rig(people[0], base, targets, load_regions())), strict=True))
    inverse = InverseSimulation(source)

    def formed(units: dict[str, float]) -> tuple[FloatArray, HeadState]:
        skin = source.skin + sum(weight * rig[unit] for unit, weight in units.items())
        return skin, inverse(skin)

    _section(source, formed(EXPRESSIONS["jaw drop"][0])[1])
    _expressions(source, target, formed)


def _expressions(
    source: Head, target: Head, formed: Callable[[dict[str, float]], tuple[FloatArray, HeadState]]
) -> None:
    faces, regions = source.template.faces, source.template.regions
    plain, full = ForwardSimulation(target, ForwardSettings(collisions=False)), ForwardSimulation(target)
    characteristics = FacialCharacteristics(Pair(faces, source.skin, target.skin, regions))
    scale = size_ratio(source.skin, target.skin)
    figure = Figure(figsize=(11.6, 3.05 * len(EXPRESSIONS)), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    grid = figure.subplots(len(EXPRESSIONS), len(COLUMNS))
    for row, (name, (units, part, view)) in zip(grid, EXPRESSIONS.items(), strict=True):
        skin, state = formed(units)
        carried = state.gradients, state.bones, scale
        last = full(*carried, characteristics(skin))
        print(f"{name!r}: {state.info.message or 'no inverted tets'}; {last.info.message or 'lips apart'}")
        shapes = skin, state.skin, plain(*carried).skin, last.skin
        for axes, shape, head in zip(row, shapes, (source, source, target, target), strict=True):
            seen = _part(regions, head.skin, part)
            axes.imshow(render_mesh(shape, faces, view(np.stack([head.skin[seen], shape[seen]]), SIZE), SIZE))
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
        row[0].set_ylabel(name, fontsize=12)
    for axes, title in zip(grid[0], COLUMNS, strict=True):
        axes.set_title(title, fontsize=12)
    _write(canvas, "simulation_expressions.png")


def _part(regions: Regions, skin: FloatArray, part: str) -> NDArray[np.bool_]:
    """(n,) vertices that the picture is centred on."""
    mark, reach = PARTS[part]
    inside: NDArray[np.bool_] = np.abs(skin - skin[regions.landmarks[mark]]).max(axis=1) < reach
    return inside


def _section(head: Head, state: HeadState) -> None:
    """Tets cut by the median plane and one through the ramus, at rest and under jaw drop."""
    figure = Figure(figsize=(11.6, 11.0), dpi=110, layout="compressed")
    canvas = FigureCanvasAgg(figure)
    grid = figure.subplots(2, 2, sharex=True, sharey=True)
    middle = float(head.skin[head.template.regions.landmarks["stomion_upper"], 0])
    ratio = np.linalg.det(state.gradients)
    for row, (where, aside) in zip(grid, PLANES.items(), strict=True):
        _cut(row[0], head, head.vertices, middle + aside, None)
        drawn = _cut(row[1], head, state.vertices, middle + aside, ratio)
        row[0].set_title(f"{where}: at rest")
        row[1].set_title(f"{where}: jaw drop")
    low, high = _lower_face(head)
    for axes in grid.flat:
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="z (mm)", ylabel="y (mm)")
        axes.label_outer()
    colors = figure.colorbar(
        drawn, ax=grid[:, 1], shrink=0.5, extend="both", ticks=[0.4, 0.6, 0.8, 1, 1.25, 1.5, 1.75, 2]
    )
    colors.set_label("volume of a tet against rest, det F")
    tissue = [Patch(color=SOFT, label="soft tissue"), Patch(color=MUSCLE, label="muscle")]
    bones = {"cranium": CRANIUM, "jaw": JAW, "bone that is free": FREE}
    lines = [Line2D([], [], color=color, lw=2, label=label) for label, color in bones.items()]
    inverted = Patch(color=INVERTED, label=f"inverted, {int((ratio <= 0).sum())} of {len(ratio)} in the head")
    grid[0, 0].legend(handles=[*tissue, *lines], frameon=False, loc="lower right")
    grid[0, 1].legend(handles=[inverted], frameon=False, loc="lower right")
    _write(canvas, "simulation_section.png")


def _lower_face(head: Head) -> FloatArray:
    """(2, 2) mm: lowest and highest z and y of what the sections show, from below the dropped jaw to the eyes."""
    marks, skin = head.template.regions.landmarks, head.skin
    front, top, chin = skin[marks["pronasale"], 2], skin[marks["nasion"], 1], skin[marks["menton"], 1]
    return np.array([[front - 150, chin - 45], [front + 6, top + 15]])


def _cut(axes: Axes, head: Head, vertices: FloatArray, x: float, ratio: FloatArray | None) -> PolyCollection:
    """Tets and skull in the plane at x, seen from the character's left, coloured by det F or, without, by tissue."""
    template = head.template
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: template.tets}, vertices)
    grid.cell_data["value"] = template.muscle.astype(float) if ratio is None else ratio
    pieces = grid.slice("x", origin=(x, 0, 0))
    values, points = np.asarray(pieces.cell_data["value"]), np.asarray(pieces.points)[:, [2, 1]]
    polygons = [points[face] for face in (pieces.regular_faces if pieces.is_all_triangles else pieces.irregular_faces)]
    drawn = PolyCollection(polygons, edgecolors="#00000030", linewidths=0.15)
    axes.add_collection(drawn)
    if ratio is None:
        drawn.set_facecolor([MUSCLE if value else SOFT for value in values])
    else:
        drawn.set(array=values, norm=TwoSlopeNorm(1.0, LEAST, MOST), cmap="RdBu")
        turned = [polygon for polygon, value in zip(polygons, values, strict=True) if value <= 0]
        axes.add_collection(PolyCollection(turned, facecolors=INVERTED, edgecolors=INVERTED, linewidths=0.4))
    for bone, color in ((template.cranium, CRANIUM), (template.jaw, JAW), (None, FREE)):
        axes.add_collection(LineCollection(_skull(head, vertices, x, bone), colors=color, linewidths=1.6))
    return drawn


def _skull(head: Head, vertices: FloatArray, x: float, bone: IntArray | None) -> list[FloatArray]:
    """Segments (2, 2) of the skull in the plane at x, of the triangles of one bone or, for None, of neither."""
    faces, bones = head.template.skull_faces, (head.template.cranium, head.template.jaw)
    inside = np.stack([np.isin(faces, part).all(axis=1) for part in (bones if bone is None else (bone,))]).any(axis=0)
    chosen = faces[inside != (bone is None)]
    lines = pv.PolyData.from_regular_faces(vertices, chosen).slice("x", origin=(x, 0, 0))
    points = np.asarray(lines.points)[:, [2, 1]]
    return [points[line] for line in lines.lines.reshape(-1, 3)[:, 1:]]


def _write(canvas: FigureCanvasAgg, name: str) -> None:
    canvas.draw()
    write_image(IMAGES / name, np.asarray(canvas.buffer_rgba())[..., :3].copy())


if __name__ == "__main__":
    main(*sys.argv[1:])
