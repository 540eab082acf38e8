"""The lining of ICT-FaceKit's nostrils, which are deep pockets: what sees little of the outside."""

from __future__ import annotations

import numpy as np
import trimesh

from retarget.geometry.graph import components, vertex_adjacency
from retarget.geometry.oriented import vertex_normals
from retarget.types import FloatArray, IntArray

SEEN = 0.19  # share of its sky that visible skin sees at least; nothing of the generic nose lies within 0.01 of it
RAYS = 512  # over the whole sphere
LIFT = 0.05  # mm above the skin where they start
AROUND = 5  # rows of vertices by which a nostril may reach beyond the region `nose`


def nostril_lining(vertices: FloatArray, faces: IntArray, nose: IntArray, mirror: IntArray) -> IntArray:
    """(k,) vertices of a head (n, 3) mm: the hidden skin at the nose (m,), alike on both sides of the mirror (n,).

    What skin sees of the sky is weighted by the cosine of the angle, as diffuse light from everywhere.
    """
    near = np.zeros(len(vertices), dtype=bool)
    near[nose] = True
    adjacency = vertex_adjacency(faces, len(vertices))
    for _ in range(AROUND):
        near |= adjacency @ near > 0
    near |= near[mirror]
    candidates = np.flatnonzero(near)
    seen = np.full(len(vertices), 1.0)
    seen[candidates] = _sky(vertices, faces, candidates)
    hidden = np.flatnonzero(0.5 * (seen + seen[mirror]) < SEEN)
    pieces = [hidden[piece] for piece in components(adjacency[hidden][:, hidden])]
    return np.sort(np.concatenate([piece for piece in pieces if np.isin(piece, nose).any()]))


def _sky(vertices: FloatArray, faces: IntArray, members: IntArray) -> FloatArray:
    """(m,) in [0, 1]: the share of directions over the skin at `members` in which no skin lies."""
    skin = trimesh.Trimesh(vertices, faces, process=False)
    normals = vertex_normals(vertices, faces)
    directions = _sphere(RAYS)
    shares = np.empty(len(members))
    for i, vertex in enumerate(members):
        cosines = directions @ normals[vertex]
        over = cosines > 0
        start = np.broadcast_to(vertices[vertex] + LIFT * normals[vertex], (int(over.sum()), 3))
        free = ~skin.ray.intersects_any(start, directions[over])
        shares[i] = cosines[over][free].sum() / cosines[over].sum()
    return shares


def _sphere(count: int) -> FloatArray:
    """(count, 3) directions spread evenly, on a Fibonacci spiral."""
    numbers = np.arange(count) + 0.5
    height, turn = 1 - 2 * numbers / count, np.pi * (1 + np.sqrt(5)) * numbers
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
