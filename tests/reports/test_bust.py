"""The cut below a head: straight, above the whole open edge, and nothing above it is lost."""

import numpy as np
import trimesh

from reports.bust import ABOVE, bust, bust_with


def test_a_ragged_rim_becomes_a_straight_one() -> None:
    ball = trimesh.creation.uv_sphere(radius=40.0, count=(60, 60))
    x, y, z = ball.triangles_center.T
    part = np.asarray(ball.faces)[z > 4.0 * np.sin(3 * np.arctan2(x, y)) - 12.0]
    vertices, faces = bust(np.asarray(ball.vertices), part)
    vertices, merged = np.unique(vertices.round(9), axis=0, return_inverse=True)
    edges = np.sort(merged[faces[:, [0, 1, 1, 2, 2, 0]]].reshape(-1, 2), axis=1)
    rim = vertices[np.unique(edges[trimesh.grouping.group_rows(edges, require_count=1)])]
    np.testing.assert_allclose(np.linalg.svd(rim - rim.mean(axis=0))[1][-1], 0.0, atol=1e-6)
    assert rim[:, 2].min() > -12.0
    assert rim[:, 2].max() < -4.0 + 4 * ABOVE
    assert abs(vertices[:, 2].max() - ball.vertices[:, 2].max()) < 1e-8


def test_a_closed_mesh_stays_as_it_is() -> None:
    ball = trimesh.creation.icosphere()
    vertices, faces = bust(np.asarray(ball.vertices), np.asarray(ball.faces))
    assert len(vertices) == len(ball.vertices)
    assert len(faces) == len(ball.faces)


def test_values_go_with_their_vertices_and_are_interpolated_on_the_cut() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=40.0)
    part = np.asarray(ball.faces)[ball.triangles_center[:, 2] > -28.0]
    heights = np.asarray(ball.vertices)[:, 2]
    vertices, faces, values = bust_with(np.asarray(ball.vertices), part, heights)
    np.testing.assert_allclose(values[faces], vertices[faces][..., 2], atol=1e-9)
    unmeasured = np.where(heights > 0, heights, np.nan)
    vertices, faces, values = bust_with(np.asarray(ball.vertices), part, unmeasured)
    assert (np.isnan(values) == (vertices[:, 2] < 1e-9))[np.unique(faces)].all()


def test_a_face_whose_rim_runs_around_it_stays_whole() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=40.0)
    mask = np.asarray(ball.faces)[ball.triangles_center[:, 2] > 20 * np.sin(ball.triangles_center[:, 0] / 10.0)]
    vertices, faces = bust(np.asarray(ball.vertices), mask)
    assert len(faces) == len(mask)
    assert len(vertices) == len(ball.vertices)
