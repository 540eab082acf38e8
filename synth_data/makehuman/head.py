"""The base head: what lies above the neck of MakeHuman's body mesh `hm08`, as mirror-symmetric triangles in mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray

MM = 100.0  # MakeHuman's unit is the decimetre
NECK = 5.75  # dm: the cut
VERTEX_COUNT, TRIANGLE_COUNT = 4328, 8608


@dataclass(frozen=True)
class BaseHead:
    """The head that every identity and every face unit displaces."""

    vertices: FloatArray  # (n, 3) mm, +y up, +z out of the face
    faces: IntArray  # (f, 3)
    body: IntArray  # (n,) index of each vertex in the body mesh, ascending; what `.target` files count in
    mirror: IntArray  # (n,) index of each vertex's mirror image


def cut_head(obj: str, mirror: str) -> BaseHead:
    """The head from the texts of ``base.obj`` and ``hm08.mirror`` (lines ``vertex image side``).

    Raises InvalidInput if the counts are not those of the mesh that regions and landmarks are authored on.
    """
    vertices, quads = _body(obj)
    above = vertices[:, 1] > NECK
    kept = quads[above[quads].all(axis=1)]
    body = np.unique(kept)
    image_of = np.array([line.split()[:2] for line in mirror.splitlines() if line.strip()], dtype=np.int64)
    image = np.empty(len(vertices), dtype=np.int64)
    image[image_of[:, 0]] = image_of[:, 1]

    position = np.full(len(vertices), -1)
    position[body] = np.arange(len(body))
    head = BaseHead(
        vertices=vertices[body] * MM,
        faces=_triangulate(position[kept], vertices[body], position[image[body]]),
        body=body,
        mirror=position[image[body]],
    )
    if (len(head.vertices), len(head.faces)) != (VERTEX_COUNT, TRIANGLE_COUNT):
        raise InvalidInput(
            f"base.obj: expected a head of {VERTEX_COUNT} vertices and {TRIANGLE_COUNT} triangles, got "
            f"{len(head.vertices)} and {len(head.faces)}; this is another base mesh than the pinned wheel holds."
        )
    return head


def _body(obj: str) -> tuple[FloatArray, IntArray]:
    """All vertices (dm) and the quads of group `body`; the other groups are helpers such as clothes and joints."""
    vertices: list[list[str]] = []
    quads: list[list[str]] = []
    group = ""
    for line in obj.splitlines():
        kind, *fields = line.split() or [""]
        if kind == "v":
            vertices.append(fields)
        elif kind == "g":
            group = fields[0]
        elif kind == "f" and group == "body":
            quads.append([corner.split("/")[0] for corner in fields])
    return np.array(vertices, dtype=np.float64), np.array(quads, dtype=np.int64) - 1


def _triangulate(quads: IntArray, vertices: FloatArray, mirror: IntArray) -> IntArray:
    """(2q, 3): each quad split along its shorter diagonal, measured on the symmetrised head.

    A quad and its mirror image have bit-equal diagonals there, so both are split alike.
    """
    symmetric = vertices + vertices[mirror] * (-1.0, 1.0, 1.0)

    def length(i: int, j: int) -> FloatArray:
        return np.linalg.norm(symmetric[quads[:, i]] - symmetric[quads[:, j]], axis=1)

    start = np.where(length(0, 2) <= length(1, 3), 0, 1)[:, None]
    a, b, c, d = (np.take_along_axis(quads, (start + i) % 4, axis=1)[:, 0] for i in range(4))
    return np.stack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)], axis=1).reshape(-1, 3)
