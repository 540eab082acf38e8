"""Loop subdivision as a linear operator, so that every shape of one topology is refined alike.

Loop, Smooth subdivision surfaces based on triangles (1987), with the boundary rule of Hoppe et al. (1994).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class Subdivision:
    """One or several steps of Loop subdivision: vertex i keeps its index, vertices of edges follow.

    A vertex set keeps its members and gains the edges inside it; a triangle set keeps its four children per
    triangle; a loop gains the vertex of each of its edges; landmarks, points and patches name the same vertices. A
    boundary between two complementary sets therefore belongs to neither at its new vertices.
    """

    operator: sp.csr_array  # (m, n): shapes @ operator.T, for each coordinate
    edges: tuple[IntArray, ...]  # of each step (e, 2), rows sorted
    faces: IntArray  # (f * 4 ** steps, 3)

    def __call__(self, shape: FloatArray) -> FloatArray:
        """(..., n, 3) positions or displacements to (..., m, 3)."""
        by_vertex = np.moveaxis(shape, -2, 0)
        columns = by_vertex.reshape(len(by_vertex), int(np.prod(by_vertex.shape[1:])))
        fine = np.asarray(self.operator @ columns).reshape(self.operator.shape[0], *by_vertex.shape[1:])
        return np.ascontiguousarray(np.moveaxis(fine, 0, -2))

    def regions(self, regions: Regions) -> Regions:
        """The same parts on the fine mesh."""
        count = self.operator.shape[1]
        for edges in self.edges:
            regions = _refine(regions, edges, count)
            count += len(edges)
        return regions


def subdivide(faces: IntArray, vertex_count: int, steps: int = 1) -> Subdivision:
    """Loop subdivision of triangles (f, 3) in `steps` steps; with 0 steps the identity."""
    operator: sp.csr_array = sp.eye_array(vertex_count, format="csr")
    edges = []
    for _ in range(steps):
        step, step_edges, faces = _step(faces, operator.shape[0])
        operator = sp.csr_array(step @ operator)
        edges.append(step_edges)
    return Subdivision(operator, tuple(edges), faces)


def _step(faces: IntArray, n: int) -> tuple[sp.csr_array, IntArray, IntArray]:
    """The operator (n + e, n), the edges (e, 2) and the fine faces (4 f, 3) of one step."""
    corners = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)  # edge i of a face: corner i to i+1
    edges, owner, uses = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    e = len(edges)
    opposite = sp.csr_array((np.ones(len(owner)), (owner, np.roll(faces, 1, axis=1).reshape(-1))), shape=(e, n))
    ends = sp.csr_array((np.ones(2 * e), (np.repeat(np.arange(e), 2), edges.reshape(-1))), shape=(e, n))
    inner = (uses == 2).astype(np.float64)
    odd = sp.diags_array(np.where(inner, 3 / 8, 1 / 2)) @ ends + sp.diags_array(inner / 8) @ opposite

    def adjacency(of: IntArray) -> sp.csr_array:
        pairs = np.concatenate([of, of[:, ::-1]])
        return sp.csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))

    rim = adjacency(edges[uses == 1])
    on_rim = np.asarray(rim.sum(axis=1)) > 0
    ring = adjacency(edges)
    valence = np.maximum(np.asarray(ring.sum(axis=1)), 1.0)
    beta = (40 - (3 + 2 * np.cos(2 * np.pi / valence)) ** 2) / (64 * valence)
    even = (
        sp.diags_array(np.where(on_rim, 3 / 4, 1 - valence * beta))
        + sp.diags_array(np.where(on_rim, 0.0, beta)) @ ring
        + sp.diags_array(np.where(on_rim, 1 / 8, 0.0)) @ rim
    )
    a, b, c = faces.T
    ab, bc, ca = (n + owner.reshape(-1, 3)).T
    fine = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return sp.csr_array(sp.vstack([even, odd])), edges, fine


def _refine(regions: Regions, edges: IntArray, n: int) -> Regions:
    """Carry regions over one step from n vertices to n + len(edges)."""
    keys = edges[:, 0] * n + edges[:, 1]  # ascending: np.unique sorts rows

    def vertex_of(ends: IntArray) -> IntArray:
        low, high = np.sort(ends, axis=1).T
        return n + np.searchsorted(keys, low * n + high)

    def inside(members: IntArray) -> IntArray:
        member = np.zeros(n, dtype=bool)
        member[members] = True
        return np.concatenate([np.sort(members), n + np.flatnonzero(member[edges].all(axis=1))])

    def round_trip(loop: IntArray) -> IntArray:
        return np.stack([loop, vertex_of(np.stack([loop, np.roll(loop, -1)], axis=1))], axis=1).reshape(-1)

    mirror = regions.mirror
    return replace(
        regions,
        vertices={name: inside(members) for name, members in regions.vertices.items()},
        loops={name: round_trip(loop) for name, loop in regions.loops.items()},
        triangles={name: np.sort((4 * t[:, None] + np.arange(4)).reshape(-1)) for name, t in regions.triangles.items()},
        mirror=None if mirror is None else np.concatenate([mirror, vertex_of(mirror[edges])]),
    )
