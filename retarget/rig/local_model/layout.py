"""Patches that overlap by rings of vertices (Chandran et al. 2022, section 3.1 and Fig. 12)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from retarget.check import InvalidInput
from retarget.geometry.graph import vertex_adjacency
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import Patches
from retarget.types import FloatArray, IntArray


@dataclass(frozen=True)
class OverlappingPatches:
    """P patches of one mesh of n vertices. A *place* is a vertex as a member of a patch; there are m places.

    A patch's share of a vertex falls linearly with its distance in rings, from the core to nothing beyond the last
    ring; the shares of a vertex sum to one. The paper leaves open how its overlapping patches become one surface.
    """

    cores: Patches  # every vertex in exactly one
    members: Patches  # each core and its rings, sorted
    neighbours: IntArray  # (e, 2) patches p < q whose cores share an edge
    shares: tuple[FloatArray, ...]  # of each member in its vertex

    @staticmethod
    def of(faces: IntArray, vertex_count: int, count: int, rings: int, seed: int = 0) -> OverlappingPatches:
        """`count` contiguous METIS patches, each grown by `rings` closed rings of vertices.

        Raises InvalidInput for a negative number of rings and as `contiguous_patches`.
        """
        check_rings(rings)
        cores = contiguous_patches(faces, vertex_count, count, seed)
        label = np.empty(vertex_count, dtype=np.int64)
        for p, core in enumerate(cores):
            label[core] = p
        adjacency = vertex_adjacency(faces, vertex_count)
        inside = sp.csr_array((np.ones(vertex_count), (np.arange(vertex_count), label)), shape=(vertex_count, count))
        share = inside.copy()
        for _ in range(rings):
            inside = sp.csr_array(inside + adjacency @ inside)
            inside.data[:] = 1.0
            share = sp.csr_array(share + inside)
        share = sp.csc_array(sp.diags_array(1.0 / share.sum(axis=1)) @ share)
        share.sort_indices()
        ends = share.indptr[1:-1]
        i, j = adjacency.nonzero()
        joined = np.unique(np.sort(np.column_stack([label[i], label[j]]), axis=1), axis=0)
        return OverlappingPatches(
            cores,
            tuple(part.astype(np.int64) for part in np.split(share.indices, ends)),
            joined[joined[:, 0] < joined[:, 1]],
            tuple(np.split(share.data, ends)),
        )

    @cached_property
    def vertices(self) -> IntArray:
        """(m,) the vertex of each place, patch by patch."""
        return np.concatenate(self.members)

    @cached_property
    def places(self) -> tuple[slice, ...]:
        """Those of each patch."""
        ends = np.cumsum([len(members) for members in self.members])
        return tuple(slice(end - len(members), end) for end, members in zip(ends.tolist(), self.members, strict=True))

    @cached_property
    def multiplicity(self) -> FloatArray:
        """(n,) in how many patches a vertex is."""
        return np.bincount(self.vertices).astype(np.float64)

    @cached_property
    def _blending(self) -> sp.csr_array:
        m = len(self.vertices)
        return sp.csr_array((np.concatenate(self.shares), (self.vertices, np.arange(m))))

    @cached_property
    def _gathering(self) -> sp.csr_array:
        m = len(self.vertices)
        return sp.csr_array((np.ones(m), (self.vertices, np.arange(m))))

    def blend(self, values: FloatArray) -> FloatArray:
        """(n, ...) the values (m, ...) at places, put together by their shares."""
        return _applied(self._blending, values)

    def total(self, values: FloatArray) -> FloatArray:
        """(n, ...) the sum over the patches that hold a vertex, of values (m, ...) at places."""
        return _applied(self._gathering, values)

    def mean(self, values: FloatArray) -> FloatArray:
        """(n, ...) the plain mean over the patches that hold a vertex, of values (m, ...) at places."""
        return self.total(values) / self.multiplicity.reshape(-1, *[1] * (values.ndim - 1))


def check_rings(rings: int) -> None:
    """Raises InvalidInput for an overlap that patches cannot have."""
    if rings < 0:
        raise InvalidInput(f"rings: expected 0 or more rings of overlap, got {rings}.")


def _applied(matrix: sp.csr_array, values: FloatArray) -> FloatArray:
    flat: FloatArray = matrix @ values.reshape(len(values), -1)
    return flat.reshape(-1, *values.shape[1:])
