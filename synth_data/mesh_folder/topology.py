"""The topology that every mesh of a folder must have: that of the first one."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from retarget.check import InvalidInput, check_faces, check_vertices
from retarget.io.mesh import read_arrays
from retarget.io.obj import ObjText
from retarget.types import FloatArray, IntArray


@dataclass(frozen=True)
class Read:
    """A mesh file as read."""

    vertices: FloatArray  # (n, 3) in the unit and axes of the file
    digest: str  # SHA-256 of the file


@dataclass(frozen=True)
class Topology:
    """Faces (f, 3) of n vertices; polygons are cut as in `file`, which set them."""

    file: Path
    vertex_count: int
    faces: IntArray
    polygon_digest: str  # of the OBJ that set them, else empty: an OBJ with the same lines need not be parsed

    @staticmethod
    def of(file: Path) -> Topology:
        """Raises InvalidInput for a mesh that cannot be read or has no faces."""
        vertices, faces, text = _parsed(file, _bytes(file))
        if faces is None:
            raise InvalidInput(
                f"{file}: expected the array 'faces' (f, 3) besides 'vertices', because this is the first mesh of the "
                "folder and sets the topology; add it. All other NPZ files may go without."
            )
        checked = check_faces(str(file), faces, len(vertices))
        return Topology(file, len(vertices), checked, text.polygon_digest() if text is not None else "")

    def read(self, file: Path) -> Read:
        """A mesh of this topology. Raises InvalidInput that names the file, also for NaN."""
        data = _bytes(file)
        if file.suffix.lower() == ".obj" and self.polygon_digest:
            text = ObjText.of(file, data)
            vertices, faces = text.vertices(), None
            if text.polygon_digest() != self.polygon_digest:
                faces = text.triangles()
        else:
            vertices, faces, _ = _parsed(file, data)
        if len(vertices) != self.vertex_count:
            raise self._differs(file, f"{len(vertices):,} vertices, expected {self.vertex_count:,}")
        if faces is not None and not same_triangles(check_faces(str(file), faces, len(vertices)), self.faces):
            what = f"{len(faces):,} triangles, expected {len(self.faces):,}"
            if len(faces) == len(self.faces):
                what = "as many triangles, but of other vertices, or polygons that start at other corners,"
            raise self._differs(file, what)
        return Read(check_vertices(str(file), vertices), hashlib.sha256(data).hexdigest())

    def _differs(self, file: Path, what: str) -> InvalidInput:
        return InvalidInput(
            f"{file}: {what} as in {self.file}. All meshes share one topology, and one of these two is of another one, "
            "exported with other settings, or truncated. Export it again, bring it into the topology by non-rigid "
            "registration, or move it out of the folder."
        )


def same_triangles(one: IntArray, other: IntArray) -> bool:
    """Whether two sets of triangles (f, 3) are the same, in any order and from any corner on."""
    return one.shape == other.shape and ((one == other).all() or bool((_canonical(one) == _canonical(other)).all()))


def _canonical(faces: IntArray) -> IntArray:
    first = faces.argmin(axis=1)
    turned = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T)]


def _parsed(file: Path, data: bytes) -> tuple[FloatArray, IntArray | None, ObjText | None]:
    if file.suffix.lower() == ".obj":
        text = ObjText.of(file, data)
        return text.vertices(), text.triangles(), text
    vertices, faces = read_arrays(file)
    return check_vertices(str(file), vertices), faces, None


def _bytes(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{file}: cannot be read ({error.strerror or error}); make it readable.") from error
