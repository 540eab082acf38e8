"""Meshes from files, vertex by vertex as the file counts them: regions and landmarks name vertices by number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from retarget.check import InvalidInput, check_faces, check_vertices
from retarget.io.files import write_whole
from retarget.io.obj import ObjText
from retarget.types import FloatArray, IntArray


def read_mesh(path: Path | str) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3) in the unit of an `.obj`, `.ply` or `.npz` file and its triangles (f, 3).

    Polygons are cut into fans. Vertices keep their numbers: none is merged, dropped or doubled for its texture. An
    `.npz` holds the arrays `vertices` and `faces`. Raises InvalidInput.
    """
    path = Path(path)
    if not path.is_file():
        raise InvalidInput(f"{path}: expected a mesh file, found none; check the path.")
    if path.suffix.lower() == ".obj":
        text = ObjText.of(path, _bytes(path))
        vertices, faces = text.vertices(), text.triangles()
    else:
        vertices, unchecked = read_arrays(path)
        if unchecked is None:
            raise InvalidInput(f"{path}: expected the array 'faces' (f, 3) besides 'vertices', found none; add it.")
        faces = unchecked
    return check_vertices(str(path), vertices), check_faces(str(path), faces, len(vertices))


def read_arrays(path: Path) -> tuple[FloatArray, IntArray | None]:
    """What a `.ply` or `.npz` file holds, unchecked; faces may be None in an `.npz`. Raises InvalidInput."""
    if path.suffix.lower() == ".npz":
        return _read_npz(path)
    if path.suffix.lower() != ".ply":
        raise InvalidInput(f"{path}: expected .obj, .ply or .npz, got {path.suffix or 'no suffix'}; convert the mesh.")
    try:
        # Otherwise vertices at seams of the texture are doubled, and files that it names are opened.
        mesh = trimesh.load_mesh(path, process=False, fix_texture=False, skip_materials=True)
        return np.asarray(mesh.vertices), np.asarray(mesh.faces)
    except Exception as error:  # trimesh raises what its parser meets
        raise InvalidInput(f"{path}: expected a PLY mesh, but it cannot be read ({error}).") from error


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be read ({error.strerror or error}); make it readable.") from error


def write_obj(path: Path | str, vertices: FloatArray, faces: IntArray) -> None:
    """Vertices (n, 3) to the micrometre if in mm, and triangles (f, 3)."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    write_whole(Path(path), lambda temporary: temporary.write_text("\n".join(lines) + "\n"))


def _read_npz(path: Path) -> tuple[FloatArray, IntArray | None]:
    names: list[str] = []
    try:
        with np.load(path, allow_pickle=False) as stored:
            names += stored
            arrays = {name: stored[name] for name in ("vertices", "faces") if name in stored}
        return arrays["vertices"], arrays.get("faces")
    except KeyError as error:
        raise InvalidInput(
            f"{path}: expected the array 'vertices' (n, 3), and 'faces' (f, 3), got {', '.join(names) or 'nothing'}."
        ) from error
    except Exception as error:  # zipfile, zlib and numpy raise what they meet; pickled objects are a ValueError
        raise InvalidInput(
            f"{path}: expected an NPZ file with plain arrays of numbers, but it cannot be read ({error}). Save it "
            "again with numpy.savez(path, vertices=..., faces=...); pickled objects are never opened."
        ) from error
