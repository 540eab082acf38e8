"""Meshes with shapes as NumPy archives: plain arrays, nothing pickled. docs/export.md lists the keys."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from retarget.check import InvalidInput, check_faces, check_frames, check_real, check_vertices
from retarget.io.files import write_whole
from retarget.io.morph_mesh import MorphMesh
from retarget.types import IntArray

KEYS = ("faces", "neutral", "shapes", "shape_names", "times", "weights", "name", "about")


def write_npz(path: Path | str, faces: IntArray, mesh: MorphMesh) -> None:
    """Positions in mm as float32, faces (f, 3) as int32, texts as text, `about` as JSON. Whole or not at all."""
    arrays: dict[str, Any] = {
        "faces": faces.astype(np.int32),
        "neutral": mesh.neutral.astype(np.float32),
        "shapes": mesh.shapes.astype(np.float32),
        "shape_names": np.array(mesh.shape_names, dtype=np.str_),
        "times": mesh.times.astype(np.float64),
        "weights": mesh.weights.astype(np.float32),
        "name": np.array(mesh.name),
        "about": np.array(json.dumps(dict(mesh.about), ensure_ascii=False)),
    }

    def save(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez(file, **arrays)

    write_whole(Path(path), save)


def read_npz(path: Path | str) -> tuple[IntArray, MorphMesh]:
    """Faces (f, 3) and the mesh of a file as `write_npz` writes it. Raises InvalidInput."""
    path = Path(path)
    if not path.is_file():
        raise InvalidInput(f"{path}: expected an exported .npz, found none; check the path.")
    try:
        with np.load(path, allow_pickle=False) as archive:
            stored = {key: archive[key] for key in KEYS}
        about = json.loads(str(stored["about"]))
    except (KeyError, ValueError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise InvalidInput(
            f"{path}: expected an archive with the arrays {', '.join(KEYS)}, but it cannot be read ({error}); "
            "export it again."
        ) from error
    neutral = check_vertices(f"{path}, neutral", stored["neutral"])
    mesh = MorphMesh(
        name=str(stored["name"]),
        neutral=neutral,
        shapes=check_frames(f"{path}, shapes", stored["shapes"], len(neutral)),
        shape_names=tuple(map(str, stored["shape_names"])),
        times=check_real(f"{path}, times", stored["times"]),
        weights=check_real(f"{path}, weights", stored["weights"]),
        about=about,
    )
    return check_faces(f"{path}, faces", stored["faces"], len(neutral)), mesh
