"""Bring your own topology: `python -m experiments.topology transfer|skin|check`, see docs/own_topology.md.

It lives here because it needs the MakeHuman head (`synth_data`) and the pictures (`reports`); what it does with them is
in `retarget`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console

from experiments.cli import with_readable_errors
from retarget.anatomy.separate import separate
from retarget.anatomy.skin import isolate_skin
from retarget.anatomy.transfer import transfer_regions
from retarget.check import InvalidInput
from retarget.io.landmarks import read_landmarks
from retarget.io.mesh import read_mesh, write_obj
from retarget.io.regions import read_regions, write_regions
from retarget.types import FloatArray, IntArray

SKIN, OPEN, REGIONS, PICTURE = "skin.obj", "open.obj", "regions.json", "check.png"


@with_readable_errors
def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m experiments.topology", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    transfer = commands.add_parser("transfer", help="regions of the MakeHuman head on a mesh, and a picture to check")
    skin = commands.add_parser("skin", help="the skin of another identity of the same topology, in mm")
    for command, what in ((transfer, "folder"), (skin, ".obj file")):
        command.add_argument("mesh", type=Path, help=".obj or .ply")
        command.add_argument("landmarks", type=Path, help="JSON: unit, and a vertex for each name")
        command.add_argument("-o", "--output", type=Path, required=True, help=f"{what} to write")
    check = commands.add_parser("check", help="check the regions of a folder again, after edits, and draw the picture")
    check.add_argument("folder", type=Path)
    options = parser.parse_args(arguments)
    console = Console()
    if options.command == "transfer":
        _transfer(options.mesh, options.landmarks, options.output, console)
    elif options.command == "skin":
        vertices, faces, _ = _skin(options.mesh, options.landmarks)
        write_obj(options.output, vertices, faces)
        console.print(f"{options.output}: {len(vertices)} vertices in mm", soft_wrap=True)
    else:
        _check(options.folder, console)


def _transfer(mesh: Path, landmarks: Path, folder: Path, console: Console) -> None:
    from synth_data.makehuman.regions import load_regions
    from synth_data.makehuman.targets import load_head

    vertices, faces, marks = _skin(mesh, landmarks)
    base, _ = load_head(progress=console.print)
    console.print(f"skin: {len(vertices)} vertices, {len(faces)} triangles, {len(marks)} landmarks")
    regions = transfer_regions((base.vertices, base.faces, load_regions()), vertices, faces, marks)
    write_obj(folder / SKIN, vertices, faces)
    write_regions(folder / REGIONS, regions)
    _check(folder, console)


def _check(folder: Path, console: Console) -> None:
    from reports.regions_sheet import regions_sheet

    vertices, faces = read_mesh(folder / SKIN)
    regions = read_regions(folder / REGIONS, len(vertices), faces)
    console.print(f"{folder / REGIONS}: fits the mesh", soft_wrap=True)
    regions_sheet(folder / PICTURE, vertices, faces, regions)
    console.print(f"{folder / PICTURE}: look at it, edit {REGIONS} where it is wrong, then run check", soft_wrap=True)
    try:
        write_obj(folder / OPEN, separate(vertices, faces, regions), faces)
    except InvalidInput as error:
        (folder / OPEN).unlink(missing_ok=True)
        raise InvalidInput(
            f"The regions and the picture are written, but no tetrahedra can be built: {error}"
        ) from error
    console.print(f"{folder / OPEN}: lips apart, ready for meshing", soft_wrap=True)


def _skin(mesh: Path, landmarks: Path) -> tuple[FloatArray, IntArray, dict[str, int]]:
    """The skin (n, 3) mm, its triangles, and the landmarks in its numbers."""
    unit, marks = read_landmarks(landmarks)
    vertices, faces = read_mesh(mesh)
    kept, faces = isolate_skin(faces, len(vertices), marks)
    return vertices[kept] * unit, faces, {name: int(np.searchsorted(kept, vertex)) for name, vertex in marks.items()}


if __name__ == "__main__":
    main()
