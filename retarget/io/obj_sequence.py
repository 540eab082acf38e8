"""A folder of OBJ files: the neutral and a file for each shape, all in one order of vertices."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from retarget.check import InvalidInput
from retarget.io.morph_mesh import MorphMesh, Positions
from retarget.types import IntArray

NEUTRAL = "neutral"


def write_obj_sequence(
    folder: Path, faces: IntArray, mesh: MorphMesh, advance: Callable[[int], None] = lambda shapes: None
) -> None:
    """``neutral.obj`` and ``<shape>.obj`` in mm, vertex i and triangle j the same in each; makes the folder.

    Raises InvalidInput for names of shapes that are no file names.
    """
    for name in mesh.shape_names:
        if name.lower() == NEUTRAL or name != Path(name).name or name.startswith("."):
            raise InvalidInput(f"{mesh.name}: the shape '{name}' cannot name a file of its own; rename it.")
    folder.mkdir(parents=True, exist_ok=True)
    triangles = face_lines(faces)
    (folder / f"{NEUTRAL}.obj").write_text(vertex_lines(mesh.neutral) + triangles)
    for name, shape in zip(mesh.shape_names, mesh.shapes, strict=True):
        (folder / f"{name}.obj").write_text(vertex_lines(shape) + triangles)
        advance(1)


def vertex_lines(vertices: Positions) -> str:
    """The lines of an OBJ file for vertices (n, 3), to six decimals."""
    return ("v %.6f %.6f %.6f\n" * len(vertices)) % tuple(vertices.ravel().tolist())


def face_lines(faces: IntArray) -> str:
    """The lines of an OBJ file for triangles (f, 3), in one smoothing group."""
    return "s 1\n" + ("f %d %d %d\n" * len(faces)) % tuple((faces + 1).ravel().tolist())
