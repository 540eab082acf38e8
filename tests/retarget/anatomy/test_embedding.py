"""The skin in the tets."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.anatomy.embedding import LARGEST_WEIGHT, embed
from retarget.check import InvalidInput
from tests.retarget.anatomy.shell import OUTER, shell, sphere


@pytest.mark.parametrize("subdivisions", [2, 4])  # coarser and finer than the tets
def test_affine_maps_are_reproduced(subdivisions: int) -> None:
    tissue = shell()
    skin, faces = sphere(OUTER, subdivisions)
    p = embed(skin, faces, tissue.vertices, tissue.tets)
    assert np.allclose(p.sum(axis=1), 1.0, atol=1e-12)
    assert np.abs(p.data).max() <= LARGEST_WEIGHT
    matrix, shift = np.array([[1.1, 0.2, 0], [-0.1, 0.9, 0.3], [0, 0.1, 1.2]]), np.array([5.0, -3, 2])
    assert np.allclose(p @ (tissue.vertices @ matrix.T + shift), skin @ matrix.T + shift, atol=1e-9)


def test_each_row_reads_one_tet() -> None:
    tissue = shell()
    skin, faces = sphere(OUTER)
    p = embed(skin, faces, tissue.vertices, tissue.tets)
    tets = {tuple(sorted(t)) for t in tissue.tets.tolist()}
    assert {tuple(sorted(p.indices[a:b].tolist())) for a, b in zip(p.indptr, p.indptr[1:], strict=False)} <= tets


def test_skin_across_a_slit_belongs_to_its_own_side() -> None:
    """Two blocks 1 mm apart, as two lips: the lower side of the upper one must not follow the lower block."""
    block = np.array([[x, y, z] for y in (0.0, 10.0) for x in (0.0, 10.0) for z in (0.0, 10.0)])
    cells = np.array([[0, 1, 2, 4], [1, 2, 3, 7], [1, 4, 5, 7], [2, 4, 6, 7], [1, 2, 4, 7]])
    edges = block[cells][:, 1:] - block[cells][:, :1]
    cells[np.linalg.det(edges) < 0] = cells[np.linalg.det(edges) < 0][:, [0, 2, 1, 3]]
    vertices, tets = np.vstack([block, block - [0, 11, 0]]), np.vstack([cells, cells + 8])
    below = np.array([[2.0, -0.7, 3], [8, -0.7, 3], [5, -0.7, 8]])  # nearer to the lower block
    p = embed(below, np.array([[0, 1, 2]]), vertices, tets)  # faces down, as the upper block does there
    normal = np.cross(below[1] - below[0], below[2] - below[0])
    assert normal[1] < 0
    assert p.indices.max() < 8
    assert np.allclose(p @ vertices, below)


def test_skin_of_another_surface_is_refused() -> None:
    tissue = shell()
    skin, faces = sphere(OUTER + 6)
    with pytest.raises(InvalidInput, match="expected it within 4 mm of the tets' boundary, got"):
        embed(skin, faces, tissue.vertices, tissue.tets)
