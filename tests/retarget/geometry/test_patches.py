import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.geometry.graph import components, vertex_adjacency
from retarget.geometry.patches import contiguous_patches
from tests.synthetic import ball


def two_balls():
    _, large = ball(4)
    _, small = ball(2)
    count = large.max() + 1
    return np.vstack([large, small + count]), count, count + small.max() + 1


@pytest.mark.parametrize("count", [1, 2, 17, 80])
def test_each_vertex_is_in_one_connected_patch(count):
    _, faces = ball(4)
    n = faces.max() + 1
    patches = contiguous_patches(faces, n, count)
    assert len(patches) == count
    np.testing.assert_array_equal(np.sort(np.concatenate(patches)), np.arange(n))
    adjacency = vertex_adjacency(faces, n)
    assert all(len(components(adjacency[patch][:, patch])) == 1 for patch in patches)
    sizes = [len(patch) for patch in patches]
    assert max(sizes) <= 1.25 * n / count


def test_components_share_the_patches_by_size():
    faces, boundary, n = two_balls()  # 2562 and 162 vertices
    patches = contiguous_patches(faces, n, 34)
    assert len(patches) == 34
    small = [patch for patch in patches if patch[0] >= boundary]
    assert len(small) == 2
    assert all(patch[-1] < boundary or patch[0] >= boundary for patch in patches)
    np.testing.assert_array_equal(np.sort(np.concatenate(patches)), np.arange(n))


def test_a_vertex_without_triangles_is_a_patch():
    _, faces = ball(3)
    n = faces.max() + 2
    patches = contiguous_patches(faces, n, 10)
    assert [n - 1] in [patch.tolist() for patch in patches]


def test_the_seed_decides():
    _, faces = ball(4)
    first, again, other = (contiguous_patches(faces, faces.max() + 1, 40, seed) for seed in (0, 0, 2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize("count", [0, 1, 10_000])
def test_refuses_impossible_counts(count):
    faces, _, n = two_balls()
    with pytest.raises(InvalidInput, match="expected a count between 2"):
        contiguous_patches(faces, n, count)
