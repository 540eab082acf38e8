"""The skin of a mesh that also holds eyeballs, teeth or lashes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from retarget.check import InvalidInput
from retarget.geometry.graph import components, vertex_adjacency
from retarget.types import IntArray


def isolate_skin(faces: IntArray, vertex_count: int, landmarks: Mapping[str, int]) -> tuple[IntArray, IntArray]:
    """The vertices (m,) of the connected piece that holds all landmarks, ascending, and its triangles (f, 3) in their
    numbers.

    It depends on the topology alone, so all identities of one topology give the same. Raises InvalidInput where the
    landmarks lie on several pieces.
    """
    for name, vertex in landmarks.items():
        if not 0 <= vertex < vertex_count:
            raise InvalidInput(
                f"landmarks[{name!r}]: expected a vertex from 0 to {vertex_count - 1}, got {vertex}; "
                "count from 0, in the numbers of this mesh."
            )
    pieces = components(vertex_adjacency(faces, vertex_count))
    piece_of = np.empty(vertex_count, dtype=np.int64)
    for number, piece in enumerate(pieces):
        piece_of[piece] = number
    names: dict[int, list[str]] = {}
    for name, vertex in landmarks.items():
        names.setdefault(int(piece_of[vertex]), []).append(name)
    if len(names) != 1:
        fewest = min(names.values(), key=len) if names else []
        raise InvalidInput(
            f"landmarks: expected all on one connected piece of the mesh, the skin, got {len(names)} pieces; "
            f"{', '.join(fewest)} may sit on an eyeball or a tooth."
        )
    kept = pieces[next(iter(names))]
    number_of = np.full(vertex_count, -1)
    number_of[kept] = np.arange(len(kept))
    mine = number_of[faces]
    return kept, mine[(mine >= 0).all(axis=1)]
