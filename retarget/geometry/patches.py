"""Contiguous patches of a mesh, for patchwise blendshapes (AnaConDaR section 3.2.1, Fig. 1)."""

from __future__ import annotations

import numpy as np
import pymetis
import scipy.sparse as sp

from retarget.check import InvalidInput
from retarget.geometry.graph import components, vertex_adjacency
from retarget.types import IntArray


def contiguous_patches(faces: IntArray, vertex_count: int, count: int = 80, seed: int = 0) -> tuple[IntArray, ...]:
    """`count` patches of about the same size: every vertex in exactly one, each connected in the vertex graph.

    METIS (Karypis and Kumar 1998) on the vertex graph, as in the paper, asked for contiguous parts. METIS refuses a
    disconnected graph, so the components share the patches in proportion to their sizes, at least one each.
    Returns `count` sorted arrays of vertex indices. Raises InvalidInput if there are more components than patches or
    fewer vertices than patches.
    """
    adjacency = vertex_adjacency(faces, vertex_count)
    pieces = components(adjacency)
    if not len(pieces) <= count <= vertex_count:
        raise InvalidInput(
            f"patches: expected a count between {len(pieces)}, the number of connected components of the mesh, and "
            f"{vertex_count}, its number of vertices, got {count}. Set the method's patch_count accordingly."
        )
    shares = _proportional_shares([len(piece) for piece in pieces], count)
    return tuple(
        patch
        for piece, share in zip(pieces, shares, strict=True)
        for patch in _split(adjacency[piece][:, piece], piece, share, seed)
    )


def _proportional_shares(sizes: list[int], count: int) -> list[int]:
    """Whole numbers >= 1 that add up to count: each next patch goes where patches are largest so far."""
    shares = [1] * len(sizes)
    for _ in range(count - len(sizes)):
        shares[max(range(len(sizes)), key=lambda i: sizes[i] / shares[i])] += 1
    return shares


def _split(adjacency: sp.csr_array, vertices: IntArray, count: int, seed: int) -> list[IntArray]:
    if count == 1:
        return [vertices]
    if count == len(vertices):
        return list(vertices[:, None])
    graph = pymetis.CSRAdjacency(adjacency.indptr.astype(np.int32), adjacency.indices.astype(np.int32))
    _, label = pymetis.part_graph(count, adjacency=graph, options=pymetis.Options(contig=True, seed=seed))
    patches = [vertices[np.asarray(label) == i] for i in range(count)]
    if empty := sum(not len(patch) for patch in patches):
        raise InvalidInput(
            f"patches: METIS left {empty} of {count} patches of a component of {len(vertices)} vertices empty. "
            "Expected several vertices per patch; ask for fewer patches."
        )
    return patches
