"""Meshes from files, vertex by vertex as the file counts them: regions and landmarks name vertices by number."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

from retarget.check import InvalidInput, check_faces, check_vertices
from retarget.io.files import write_whole
from retarget.types import FloatArray, IntArray


def read_mesh(path: Path | str) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3) in the unit of an `.obj` or `.ply` file and its triangles (f, 3); polygons are cut into fans.

    Vertices keep their numbers: none is merged, dropped or doubled for its texture. Raises InvalidInput.
    """
    path = Path(path)
    if not path.is_file():
        raise InvalidInput(f"{path}: expected a mesh file, found none; check the path.")
    if path.suffix.lower() == ".obj":
        vertices, faces = _read_obj(path)
    elif path.suffix.lower() == ".ply":
        try:
            mesh = trimesh.load_mesh(path, process=False)
        except Exception as error:  # trimesh raises what its parser meets
            raise InvalidInput(f"{path}: expected a PLY mesh, but it cannot be read ({error}).") from error
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    else:
        raise InvalidInput(f"{path}: expected .obj or .ply, got {path.suffix or 'no suffix'}; convert the mesh.")
    return check_vertices(str(path), vertices), check_faces(str(path), faces, len(vertices))


def write_obj(path: Path | str, vertices: FloatArray, faces: IntArray) -> None:
    """Vertices (n, 3) to the micrometre if in mm, and triangles (f, 3)."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    write_whole(Path(path), lambda temporary: temporary.write_text("\n".join(lines) + "\n"))


def _read_obj(path: Path) -> tuple[FloatArray, IntArray]:
    # Read here because trimesh and VTK double the vertices at seams of the texture.
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    with path.open() as file:
        for number, line in enumerate(file, 1):
            kind, *fields = line.split() or [""]
            try:
                if kind == "v":
                    x, y, z = fields[:3]
                    vertices.append([float(x), float(y), float(z)])
                elif kind == "f":
                    corners = [int(corner.split("/")[0]) for corner in fields]
                    polygon = [c - 1 if c > 0 else len(vertices) + c for c in corners]
                    triangles += [(polygon[0], b, c) for b, c in pairwise(polygon[1:])]
            except ValueError as error:
                raise InvalidInput(f"{path}: line {number} cannot be read as OBJ: {line.strip()[:60]!r}.") from error
    return np.array(vertices).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)
