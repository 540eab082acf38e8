"""The depth table and its spreading over the skin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from retarget.anatomy.depths import depth_basis, landmark_depths, load_depths
from retarget.check import InvalidInput
from retarget.types import Regions
from synth_data.makehuman.regions import load_regions


def test_the_shipped_table_fits_the_makehuman_landmarks() -> None:
    depths = load_depths()
    assert len(depths) == 21
    assert depths["rhinion"] == 2.5
    placed = landmark_depths(depths, load_regions())
    assert len(placed) == 10 + 2 * 11
    assert placed["gonion_left"] == placed["gonion_right"] == 10.5


def test_a_landmark_that_the_topology_lacks_is_named() -> None:
    with pytest.raises(InvalidInput, match=r"expected menton \(or menton_left and menton_right\)"):
        landmark_depths({"menton": 8.0}, Regions(landmarks={"nasion": 3}))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,depth\nmenton,8\n", "expected the columns landmark and depth_mm"),
        ("landmark,depth_mm\nmenton,-8\n", r"depth in \(0, 24\] mm at menton, got '-8'"),
        ("landmark,depth_mm\nmenton,nan\n", "at menton, got 'nan'"),
        ("landmark,depth_mm\nmenton,thick\n", "at menton, got 'thick'"),
        ("landmark,depth_mm\nmenton,8\nmenton,9\n", "got menton twice"),
    ],
)
def test_a_wrong_table_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "depths.csv"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=message):
        load_depths(path)


def test_another_table_and_a_missing_one(tmp_path: Path) -> None:
    path = tmp_path / "depths.csv"
    path.write_text("landmark,depth_mm\nmenton,8.5\n")
    assert load_depths(path) == {"menton": 8.5}
    with pytest.raises(InvalidInput, match="expected a readable file"):
        load_depths(tmp_path / "none.csv")


def test_the_basis_interpolates_and_reproduces_constants() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=80.0)
    marks = np.array([0, 5, 100, 700])
    basis = depth_basis(np.array(ball.vertices), np.array(ball.faces, dtype=np.int64), marks)
    assert np.array_equal(basis[marks], np.eye(4))
    assert np.abs(basis.sum(axis=1) - 1).max() < 1e-8


def test_the_field_is_smooth_and_hardly_leaves_the_range_of_its_landmarks() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=80.0)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces, dtype=np.int64)
    marks = np.array([0, 5, 100, 700])
    field = depth_basis(vertices, faces, marks) @ np.array([4.0, 8.0, 12.0, 18.0])
    assert field.min() > 3.0
    assert field.max() < 19.0
    edges = np.array(ball.edges_unique)
    slope = np.abs(field[edges[:, 0]] - field[edges[:, 1]]) / np.linalg.norm(
        vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1
    )
    assert slope.max() < 0.2  # mm per mm: a pure membrane has spikes at its landmarks, 0.48 here


def test_a_piece_without_a_landmark_is_refused() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=80.0)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces, dtype=np.int64)
    with pytest.raises(InvalidInput, match="a piece of 42 vertices without"):
        depth_basis(np.vstack([vertices, vertices + 200]), np.vstack([faces, faces + 42]), np.array([0]))
