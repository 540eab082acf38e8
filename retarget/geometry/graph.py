"""The vertex graph of a triangle mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from retarget.types import IntArray


def half_edges(faces: IntArray) -> IntArray:
    """(3f, 2) directed edges of triangles (f, 3): the first of all, then the second, then the third."""
    edges: IntArray = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return edges


def vertex_adjacency(faces: IntArray, vertex_count: int) -> sp.csr_array:
    """(n, n) symmetric 0/1 matrix of the edges, without a diagonal, indices sorted."""
    i = faces.ravel()
    j = np.roll(faces, -1, axis=1).ravel()
    adjacency = sp.csr_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(vertex_count, vertex_count))
    adjacency.data[:] = 1.0
    adjacency.sort_indices()
    return adjacency


def components(adjacency: sp.csr_array) -> list[IntArray]:
    """The connected components as sorted vertex indices, in the order of their first vertices."""
    count, label = connected_components(adjacency, directed=False)
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(1, count))
    return [part.astype(np.int64) for part in np.split(order, starts)]
