"""Wavefront OBJ: positions and polygons, numbered as in the file.

Read here because trimesh and VTK double the vertices at seams of the texture, and because folders of thousands of
meshes want to be read in bulk.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray

_VERTEX, _FACE = (b"v ", b"v\t"), (b"f ", b"f\t")


@dataclass(frozen=True)
class ObjText:
    """The lines of an OBJ file."""

    name: str  # for errors
    lines: Sequence[bytes]

    @staticmethod
    def of(name: Path | str, data: bytes) -> ObjText:
        return ObjText(str(name), [line.strip() for line in data.split(b"\n")])

    def vertices(self) -> FloatArray:
        """(n, 3) in the unit of the file; colours behind a position are passed over. Raises InvalidInput."""
        found = [line for line in self.lines if line.startswith(_VERTEX)]
        fields = b" ".join(found).split()
        if len(fields) == 4 * len(found):
            del fields[::4]  # the letters; where a line has too few fields, one stays and is no number
            try:
                return np.array(list(map(float, fields))).reshape(-1, 3)
            except ValueError:
                pass  # told with its line below
        positions = []
        for number, line in enumerate(self.lines, 1):
            if line.startswith(_VERTEX):
                try:
                    x, y, z = map(float, line.split()[1:4])
                except ValueError as error:
                    raise self._unreadable(number) from error
                positions.append((x, y, z))
        return np.array(positions).reshape(-1, 3)

    def triangles(self) -> IntArray:
        """(f, 3) from 0; polygons are cut into fans from their first corner. Raises InvalidInput."""
        count, triangles = 0, []
        for number, line in enumerate(self.lines, 1):
            if line.startswith(_VERTEX):
                count += 1
            elif line.startswith(_FACE):
                try:
                    corners = [int(corner.split(b"/")[0]) for corner in line.split()[1:]]
                except ValueError as error:
                    raise self._unreadable(number) from error
                first, *others = [c - 1 if c > 0 else count + c for c in corners]
                triangles += [(first, b, c) for b, c in pairwise(others)]
        return np.array(triangles, dtype=np.int64).reshape(-1, 3)

    def polygon_digest(self) -> str:
        """SHA-256 of the lines that say polygons: equal ones mean equal triangles if they count from the front."""
        return hashlib.sha256(b"\n".join(line for line in self.lines if line.startswith(_FACE))).hexdigest()

    def _unreadable(self, number: int) -> InvalidInput:
        line = self.lines[number - 1].decode(errors="replace")
        return InvalidInput(f"{self.name}: line {number} cannot be read as OBJ: {line[:60]!r}.")
