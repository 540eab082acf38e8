"""Overlapping patches of the MakeHuman-free kind: grids and balls."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.geometry.graph import vertex_adjacency
from retarget.geometry.patches import contiguous_patches
from retarget.rig.local_model.layout import OverlappingPatches
from tests.synthetic import ball

VERTICES, FACES = ball()
N = len(VERTICES)


def layout(rings: int) -> OverlappingPatches:
    return OverlappingPatches.of(FACES, N, 12, rings)


def test_without_rings_the_patches_are_their_cores() -> None:
    patches = layout(0)
    for members, core, shares in zip(patches.members, contiguous_patches(FACES, N, 12), patches.shares, strict=True):
        np.testing.assert_array_equal(members, core)
        np.testing.assert_array_equal(shares, 1.0)


def test_each_ring_adds_the_neighbours_of_the_last() -> None:
    adjacency = vertex_adjacency(FACES, N)
    for inner, outer in zip(layout(1).members, layout(2).members, strict=True):
        ring = np.unique(np.concatenate([inner, *(adjacency[[v]].indices for v in inner)]))
        np.testing.assert_array_equal(outer, ring)


def test_shares_of_a_vertex_sum_to_one_and_fall_from_the_core() -> None:
    patches = layout(3)
    np.testing.assert_allclose(patches.blend(np.ones(len(patches.vertices))), 1.0)
    raw = [shares * 4 for shares in patches.shares]
    for members, core, shares in zip(patches.members, patches.cores, raw, strict=True):
        alone = np.isin(members, core) & (patches.multiplicity[members] == 1)
        np.testing.assert_allclose(shares[alone], 4.0)
        assert shares[np.isin(members, core)].min() > shares[~np.isin(members, core)].min()


def test_values_that_agree_are_kept_by_blend_and_mean() -> None:
    patches = layout(2)
    at_places = VERTICES[patches.vertices]
    np.testing.assert_allclose(patches.blend(at_places), VERTICES, atol=1e-12)
    np.testing.assert_allclose(patches.mean(at_places), VERTICES, atol=1e-12)


def test_neighbours_are_the_patches_whose_cores_share_an_edge() -> None:
    patches = layout(2)
    label = np.empty(N, dtype=int)
    for p, core in enumerate(patches.cores):
        label[core] = p
    expected = {
        (min(label[a], label[b]), max(label[a], label[b]))
        for a, b in np.vstack([FACES[:, :2], FACES[:, 1:]])
        if label[a] != label[b]
    }
    assert set(map(tuple, patches.neighbours)) == expected


def test_a_negative_overlap_is_refused() -> None:
    with pytest.raises(InvalidInput, match="rings: expected 0 or more"):
        layout(-1)
