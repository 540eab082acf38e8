"""A clone of ICT-FaceKit on the user's disk: which files it has, and the skin in each of them.

The skin is the first 14,062 vertices: face, head and neck, mouth and eye sockets. Eyeballs, teeth, lashes and what
else follows are left out. The file gives centimetres, +y up, +z out of the face.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from retarget.check import InvalidInput, check_vertices
from retarget.io.mesh import read_mesh
from retarget.types import FloatArray, IntArray
from synth_data.ict_facekit.expressions import EXPRESSIONS

FOLDER = "FaceXModel"
NEUTRAL = "generic_neutral_mesh"
VERTICES, SKIN_VERTICES, SKIN_TRIANGLES = 26_719, 14_062, 28_068
MM = 10.0  # per unit of the files
WHERE = "git clone https://github.com/ICT-VGL/ICT-FaceKit (MIT licence), then dataset.root=/path/to/ICT-FaceKit"

_LFS = b"version https://git-lfs"
_MODE = re.compile(r"identity(\d+)")


@dataclass(frozen=True)
class Clone:
    """The files that are used, whose existence is checked."""

    neutral: Path
    expressions: Mapping[str, Path]  # all of `EXPRESSIONS`
    modes: Mapping[int, Path]  # by number, ascending: whichever are there

    @property
    def files(self) -> tuple[Path, ...]:
        return (self.neutral, *self.expressions.values(), *self.modes.values())

    def digest(self) -> str:
        """SHA-256 over names and contents of all files that are used. Raises InvalidInput for one that is no mesh."""
        total = hashlib.sha256()
        for path in self.files:
            try:
                with path.open("rb") as file:
                    if file.read(len(_LFS)) == _LFS:
                        raise InvalidInput(
                            f"{path}: expected a mesh, got a pointer of Git LFS. Run `git lfs pull` in the clone."
                        )
                    file.seek(0)
                    total.update(path.stem.encode() + hashlib.file_digest(file, "sha256").digest())
            except OSError as error:
                raise InvalidInput(
                    f"{path} cannot be read ({error.strerror}); make it readable for this user."
                ) from error
        return total.hexdigest()


def find_clone(root: str | Path | None) -> Clone:
    """The files of the clone at `root`, or at its folder FaceXModel. Raises InvalidInput that names what is missing."""
    if root is None:
        raise InvalidInput(f"dataset.root: expected a clone of ICT-FaceKit, got none. {WHERE}")
    folder = Path(root).expanduser()
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise InvalidInput(f"dataset.root: {folder} {what}, expected a clone of ICT-FaceKit. {WHERE}")
    if folder.name != FOLDER:
        folder = folder / FOLDER
    if not folder.is_dir():
        raise InvalidInput(f"{folder}: expected this folder of the clone, found none. {WHERE}")
    meshes = {path.stem: path for path in sorted(folder.glob("*.obj"))}
    missing = [name for name in (NEUTRAL, *EXPRESSIONS) if name not in meshes]
    if missing:
        raise InvalidInput(
            f"{folder}: expected {NEUTRAL}.obj and the {len(EXPRESSIONS)} expressions, {len(missing)} of these files "
            f"are missing: {', '.join(f'{name}.obj' for name in missing)}. Restore them: `git checkout -- {FOLDER}`."
        )
    modes = {int(found[1]): path for name, path in meshes.items() if (found := _MODE.fullmatch(name))}
    if not modes:
        raise InvalidInput(
            f"{folder}: expected at least one identity mode, identity000.obj and so on, found none; without them all "
            f"people are alike. Restore them with `git checkout -- {FOLDER}`."
        )
    return Clone(meshes[NEUTRAL], {name: meshes[name] for name in EXPRESSIONS}, dict(sorted(modes.items())))


def read_neutral(path: Path) -> tuple[FloatArray, IntArray]:
    """The skin (14062, 3) mm and its triangles (28068, 3). Raises InvalidInput for another topology."""
    vertices, faces = read_mesh(path)
    check_count(path, len(vertices))
    skin = faces[(faces < SKIN_VERTICES).all(axis=1)]
    if len(skin) != SKIN_TRIANGLES:
        raise InvalidInput(
            f"{path}: expected {SKIN_TRIANGLES} triangles of skin among the first {SKIN_VERTICES} vertices, got "
            f"{len(skin)}; this is another topology than that of the public ICT-FaceKit."
        )
    return in_mm(vertices[:SKIN_VERTICES]), skin


def read_skin(path: Path) -> FloatArray:
    """(14062, 3) mm: the skin in one file, which is read line by line. Raises InvalidInput."""
    with path.open("rb") as file:
        lines = (line for line in file if line.startswith(b"v "))
        skin = list(islice(lines, SKIN_VERTICES))
        check_count(path, len(skin) + sum(1 for _ in lines))
    try:
        values = np.array(b" ".join(line[2:] for line in skin).split(), dtype=np.float64)
        vertices = values.reshape(SKIN_VERTICES, 3)
    except ValueError as error:
        raise InvalidInput(
            f"{path}: expected three numbers for each vertex, but it cannot be read ({error}); restore the file with "
            f"`git checkout -- {FOLDER}/{path.name}`."
        ) from error
    return in_mm(check_vertices(str(path), vertices))


def check_count(path: Path, found: int) -> None:
    """Raises InvalidInput for a mesh of another topology, or one that was cut short."""
    if found != VERTICES:
        raise InvalidInput(
            f"{path}: expected {VERTICES} vertices, got {found}; the file is damaged or of another version. Restore it "
            f"with `git checkout -- {FOLDER}/{path.name}`."
        )


def in_mm(vertices: FloatArray) -> FloatArray:
    """In single precision, which is more than the files give."""
    return (MM * vertices).astype(np.float32).astype(np.float64)
