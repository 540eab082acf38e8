"""Loops of edges on grids and spheres whose loops are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from retarget.check import InvalidInput
from retarget.geometry.edge_loops import boundary_loops, is_edge_cycle, parts, trace
from retarget.geometry.oriented import OrientedSurface, vertex_normals
from retarget.geometry.strip import strip
from retarget.geometry.triangles import areas
from retarget.types import FloatArray, IntArray


def globe(rows: int = 24, columns: int = 36, radius: float = 50.0) -> tuple[FloatArray, IntArray]:
    """Rows of latitude without the poles: vertex row * columns + column, outward, open at both ends."""
    latitude, longitude = np.meshgrid(
        np.linspace(-1.2, 1.2, rows), 2 * np.pi * np.arange(columns) / columns, indexing="ij"
    )
    v = radius * np.stack(
        [np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)]
    )
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = (i * columns + j).ravel(), (i * columns + (j + 1) % columns).ravel()
    c, d = a + columns, b + columns
    return v.reshape(3, -1).T, np.concatenate([np.column_stack([a, b, d]), np.column_stack([a, d, c])])


def test_the_open_edges_of_a_globe_are_its_first_and_last_row() -> None:
    vertices, faces = globe()
    found = sorted(sorted(loop.tolist()) for loop in boundary_loops(faces))
    assert found == [list(range(36)), list(range(23 * 36, 24 * 36))]
    assert all(is_edge_cycle(loop, faces, len(vertices)) for loop in boundary_loops(faces))
    assert boundary_loops(np.asarray(trimesh.creation.icosphere(1).faces, dtype=np.int64)) == []


def test_a_cycle_needs_edges_and_no_vertex_twice() -> None:
    vertices, faces = globe()
    row = np.arange(36)
    assert is_edge_cycle(row, faces, len(vertices))
    assert not is_edge_cycle(row[::2], faces, len(vertices))
    assert not is_edge_cycle(np.r_[row, row], faces, len(vertices))


@pytest.mark.parametrize("picked", [{}, {12: 11 * 36 + 9}])
def test_a_loop_along_a_row_is_that_row_though_the_curve_wavers(picked: dict[int, int]) -> None:
    vertices, faces = globe()
    row = vertices[11 * 36 : 12 * 36]
    angle = 2 * np.pi * np.arange(48) / 48
    curve = 50 * np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    curve[:, 1] = row[0, 1] + 3.6 * np.cos(3 * angle)  # rows are 5.2 mm apart
    loop = trace("row", (curve, curve / 50), picked, vertices, vertex_normals(vertices, faces), faces)
    assert is_edge_cycle(loop, faces, len(vertices))
    assert set(loop.tolist()) == set(range(11 * 36, 12 * 36))
    steps = (np.diff(np.r_[loop, loop[0]]) + 18) % 36 - 18
    assert (steps == 1).all()  # in the direction of the curve


def test_a_loop_goes_through_what_was_picked() -> None:
    vertices, faces = globe()
    angle = 2 * np.pi * np.arange(12) / 12
    curve = 50 * np.column_stack([np.sin(angle), 0.05 + 0 * angle, np.cos(angle)])
    picked = 13 * 36 + 9  # one row off
    loop = trace("row", (curve, curve / 50), {3: picked}, vertices, vertex_normals(vertices, faces), faces)
    assert picked in loop
    assert is_edge_cycle(loop, faces, len(vertices))


def test_a_loop_about_a_slit_does_not_meet_itself() -> None:
    vertices, faces = globe()
    angle = 2 * np.pi * np.arange(16) / 16
    longitude = np.cos(angle)
    height = vertices[12 * 36, 1] + 0.2 * np.sin(angle)  # along a row, 100 mm wide and 0.4 mm high
    curve = np.column_stack([50 * np.sin(longitude), height, 50 * np.cos(longitude)])
    loop = trace("slit", (curve, curve / 50), {}, vertices, vertex_normals(vertices, faces), faces)
    assert is_edge_cycle(loop, faces, len(vertices))
    assert np.abs(vertices[loop, 1] - vertices[12 * 36, 1]).max() < 6.0


def test_a_curve_away_from_the_mesh_is_refused() -> None:
    vertices, faces = globe()
    torn = faces[~np.isin(faces, np.arange(5, 24 * 36, 36)).any(axis=1)]  # a meridian is missing
    angle = 2 * np.pi * np.arange(12) / 12
    curve = 50 * np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    with pytest.raises(InvalidInput, match="equator: found no path of edges"):
        trace("equator", (curve, curve / 50), {}, vertices, vertex_normals(vertices, torn), torn)


def test_two_rows_cut_a_globe_into_three_parts() -> None:
    vertices, faces = globe()
    found = parts(faces, len(vertices), {"low": np.arange(5 * 36, 6 * 36), "high": np.arange(15 * 36, 16 * 36)})
    assert {tuple(sorted(key)): len(members) // 36 for key, members in found.items()} == {
        ("low",): 5,
        ("high", "low"): 9,
        ("high",): 8,
    }


def test_closest_points_tell_the_sides_of_a_gap_apart() -> None:
    corners = np.array([[0.0, 0, 0], [30, 0, 0], [30, 30, 0], [0, 30, 0]])
    vertices = np.vstack([corners, corners + np.array([0, 0, 0.5])])
    up, down = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[4, 6, 5], [4, 7, 6]])  # two sheets that face each other
    surface = OrientedSurface(vertices, np.vstack([up, down]))
    points = np.array([[10.0, 12.0, 0.4], [10.0, 12.0, 0.1]])  # each nearer to the other sheet
    sample = surface.closest(points, np.array([[0.0, 0, 1], [0, 0, -1]]))
    np.testing.assert_allclose(surface.positions[sample, 2], [0.0, 0.5])
    assert np.abs(surface.positions[sample, :2] - [10, 12]).max() < 2.0


def test_a_strip_fills_its_loop_from_corner_to_corner() -> None:
    angle = np.sort(np.random.default_rng(0).uniform(0, 2 * np.pi, 17))
    points = np.column_stack([20 * np.cos(angle), 9 * np.sin(angle), 0 * angle])
    made = strip(points, np.arange(17), 7)
    assert len(made) == 15
    polygon = 0.5 * abs(np.sum(np.cross(points, np.roll(points, -1, axis=0))[:, 2]))
    assert areas(points, made).sum() == pytest.approx(polygon)
