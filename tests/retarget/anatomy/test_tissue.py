"""The mesher's tets, their boundary and their refinement."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from retarget.anatomy.boundary import boundary_faces, enclosed_volume, signed_volumes
from retarget.anatomy.closed import check_closed
from retarget.anatomy.mesher import tetrahedralise
from retarget.anatomy.tissue import Tissue, refine
from retarget.check import InvalidInput
from retarget.simulation.tetrahedra import rest_shape
from retarget.types import FloatArray, IntArray
from tests.retarget.anatomy.shell import shell, sphere


def packed(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    used, local = np.unique(faces, return_inverse=True)
    return vertices[used], local.reshape(-1, 3)


def test_tets_fill_the_space_between_the_surfaces() -> None:
    tissue = shell()
    volumes = signed_volumes(tissue.vertices, tissue.tets)
    assert volumes.min() > 0
    wanted = enclosed_volume(*sphere(60.0)) - enclosed_volume(*sphere(40.0))
    assert volumes.sum() == pytest.approx(wanted, rel=0.01)
    rest_shape(tissue.vertices, tissue.tets)


def test_a_surface_that_encloses_nothing_is_refused_and_no_files_are_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    square = 20.0 * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]])
    box = 50.0 * np.array([[-1.0, -1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    with pytest.raises(InvalidInput, match="tetrahedra: "):
        tetrahedralise(square, faces, (box, np.array([[0, 1, 2, 3]]), np.full(4, 20.0)), 0.5, 20.0)
    assert list(tmp_path.iterdir()) == []


def test_the_boundary_is_two_closed_surfaces() -> None:
    tissue = shell()
    triangles, owner = boundary_faces(tissue.tets)
    assert np.isin(triangles, tissue.tets[owner]).all()
    inner = {tuple(sorted(t)) for t in tissue.skull_faces.tolist()}
    skin = np.array([t for t in triangles.tolist() if tuple(sorted(t)) not in inner])
    check_closed("skin", *packed(tissue.vertices, skin))
    check_closed("skull", *packed(tissue.vertices, tissue.skull_faces))  # outward of the bone


def test_refinement_divides_by_eight_and_stays_conforming() -> None:
    tissue = shell()
    fine = refine(tissue)
    parents = signed_volumes(tissue.vertices, tissue.tets)
    assert np.allclose(signed_volumes(fine.vertices, fine.tets).reshape(-1, 8), parents[:, None] / 8)
    assert np.array_equal(fine.vertices[: len(tissue.vertices)], tissue.vertices)
    triangles, _ = boundary_faces(fine.tets)
    assert len(triangles) == 4 * len(boundary_faces(tissue.tets)[0])  # no face of a child is left alone inside
    boundary = {tuple(sorted(t)) for t in triangles.tolist()}
    assert {tuple(sorted(t)) for t in fine.skull_faces.tolist()} <= boundary
    assert enclosed_volume(fine.vertices, fine.skull_faces) == pytest.approx(
        enclosed_volume(tissue.vertices, tissue.skull_faces)
    )


@pytest.mark.parametrize("swap", [(0, 1, 2, 3), (1, 2, 0, 3), (2, 0, 1, 3)])
def test_each_way_to_cut_the_octahedron_is_positively_oriented(swap: tuple[int, ...]) -> None:
    flat = np.array([[0.0, 0, 0], [10, 0, 0], [5, 3, 0], [5, 1, 2]])
    tissue = Tissue(flat, np.array([swap]), np.array([swap[:3]]))
    whole = signed_volumes(flat, tissue.tets)[0]
    children = refine(tissue)
    assert whole > 0
    assert np.allclose(signed_volumes(children.vertices, children.tets), whole / 8)
