"""The picture of lip collisions in docs/simulation.md: `python docs/forward_figures.py`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from reports.camera import three_quarter
from reports.render import render_mesh, write_image
from retarget.anatomy.head import Head
from retarget.anatomy.store import load_template
from retarget.simulation.forward import ForwardSettings, ForwardSimulation, ForwardState
from retarget.simulation.inverse import InverseSimulation
from retarget.types import FloatArray
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head

IMAGES = Path(__file__).parent / "images"
SIZE = (480, 480)
BEFORE, AFTER = "#c1121f", "#1d3557"
EXPRESSIONS = {
    "lips pressed together": {"mouthPressLeft": 1, "mouthPressRight": 1},
    "jaw closed too far": {"jawOpen": -0.1},
}


def main() -> None:
    base, targets = load_head()
    fine = subdivide(base.faces, len(base.vertices))
    regions = fine.regions(load_regions())
    template = load_template(fine.faces, regions, "coarse")
    condyles = np.stack([regions.points[f"condyle_{side}"](template.skin) for side in ("left", "right")])
    head = Head(template, template.skin, template.vertices, condyles, {})
    inverse = InverseSimulation(head)
    simulations = ForwardSimulation(head, ForwardSettings(collisions=False)), ForwardSimulation(head)
    figure = Figure(figsize=(11, 7.6), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    for name, units, row in zip(EXPRESSIONS, EXPRESSIONS.values(), figure.subplots(2, 3), strict=True):
        moved = sum(weight * targets[f"units/{unit}"] for unit, weight in units.items())
        formed = inverse(head.skin + fine(moved))
        states = [simulation(formed.gradients, formed.bones) for simulation in simulations]
        print(f"{name}: {states[1].info.message}")
        _pictures(row[:2], name, head, states)
        _section(row[2], head, states)
    canvas.draw()
    write_image(IMAGES / "simulation_lips.png", np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _pictures(row: Sequence[Axes], name: str, head: Head, states: Sequence[ForwardState]) -> None:
    """Before and after."""
    mouth = np.abs(head.skin - head.skin[head.template.regions.landmarks["stomion_upper"]]).max(axis=1) < 26
    camera = three_quarter(head.skin[mouth], SIZE)
    for axes, state, title in zip(row, states, ("lips crossed", "resolved"), strict=True):
        axes.imshow(render_mesh(state.skin, head.template.faces, camera, SIZE))
        axes.set_title(f"{name}: {title}")
        axes.axis("off")


def _section(axes: Axes, head: Head, states: Sequence[ForwardState]) -> None:
    """The lips in the median plane, seen from the character's left."""
    middle = head.skin[head.template.regions.landmarks["stomion_upper"]]
    for state, color, label in zip(states, (BEFORE, AFTER), ("crossed", "resolved"), strict=True):
        for number, line in enumerate(_cut(state.skin, head, float(middle[0]) + 0.3)):
            axes.plot(line[:, 2], line[:, 1], color=color, lw=1.6, label=label if number == 0 else None)
    axes.set(xlim=(middle[2] - 8, middle[2] + 12), ylim=(middle[1] - 10, middle[1] + 10), aspect="equal")
    axes.set(xlabel="z (mm)", ylabel="y (mm)", title="median section")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(5))
    axes.legend(frameon=False, loc="lower right")


def _cut(skin: FloatArray, head: Head, x: float) -> list[FloatArray]:
    """Segments (2, 3) mm of the skin in the plane at x, joined to lines."""
    mesh = pv.PolyData.from_regular_faces(skin, head.template.faces)
    lines = mesh.slice("x", origin=(x, 0, 0)).strip(join=True)
    points, cells, parts, at = np.asarray(lines.points, dtype=np.float64), lines.lines, [], 0
    while at < len(cells):
        parts.append(points[cells[at + 1 : at + 1 + cells[at]]])
        at += 1 + cells[at]
    return parts


if __name__ == "__main__":
    main()
