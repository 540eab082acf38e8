"""Capping and the checks of closed surfaces, on shapes whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from retarget.anatomy.closed import cap, check_closed, euler_number
from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray


@pytest.fixture
def sphere() -> tuple[FloatArray, IntArray]:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=50.0)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def test_a_hole_is_closed_by_a_fan_that_faces_outward(sphere: tuple[FloatArray, IntArray]) -> None:
    vertices, faces = sphere[0][1:], sphere[1] - 1  # without vertex 0
    opened = faces[(faces >= 0).all(axis=1)]
    capped, closed = cap("ball", vertices, opened)
    assert len(capped) == len(vertices) + 1
    assert euler_number(closed) == 2
    check_closed("ball", capped, closed)
    assert np.array_equal(capped[:-1], vertices)
    assert trimesh.Trimesh(capped, closed, process=False).is_winding_consistent


def test_a_closed_surface_is_not_capped(sphere: tuple[FloatArray, IntArray]) -> None:
    vertices, faces = cap("ball", *sphere)
    assert np.array_equal(vertices, sphere[0])
    assert np.array_equal(faces, sphere[1])


def test_open_inward_and_separate_surfaces_are_refused(sphere: tuple[FloatArray, IntArray]) -> None:
    vertices, faces = sphere
    with pytest.raises(InvalidInput, match=r"expected a closed surface, got 3 edges"):
        check_closed("ball", vertices, faces[1:])
    with pytest.raises(InvalidInput, match="face outward"):
        check_closed("ball", vertices, faces[:, ::-1])
    two = np.vstack([vertices, vertices + 200.0]), np.vstack([faces, faces + len(vertices)])
    with pytest.raises(InvalidInput, match=r"Euler number 2.*got 4"):
        check_closed("balls", *two)
    torus = trimesh.creation.torus(30.0, 8.0)
    with pytest.raises(InvalidInput, match=r"Euler number 2.*got 0"):
        check_closed("ring", np.array(torus.vertices), np.array(torus.faces, dtype=np.int64))


def test_holes_besides_the_neck_are_refused_with_their_place(sphere: tuple[FloatArray, IntArray]) -> None:
    vertices, faces = sphere
    neck = np.argsort(vertices[faces].mean(axis=1)[:, 1])[:12]
    cheek = int(np.argmax(vertices[faces].mean(axis=1)[:, 0]))
    used, opened = np.unique(np.delete(faces, np.append(neck, cheek), axis=0), return_inverse=True)
    where = np.round(vertices[faces[cheek]].mean(axis=0), 1)
    with pytest.raises(InvalidInput, match=f"got 1 more, the first of 3 edges near .{where[0]}"):
        cap("ball", vertices[used], opened.reshape(-1, 3))
    loose = np.vstack([vertices, [[0.0, 0.0, 0.0]]])
    with pytest.raises(InvalidInput, match=f"none at 1 of {len(loose)}, the first is vertex {len(vertices)}"):
        cap("ball", loose, faces)


def test_wrong_edges_are_refused_before_capping(sphere: tuple[FloatArray, IntArray]) -> None:
    vertices, faces = sphere
    with pytest.raises(InvalidInput, match="at most two triangles at an edge, got 3"):
        cap("ball", vertices, np.vstack([faces, [faces[0, 0], faces[0, 1], 100]]))
    turned = faces.copy()
    turned[0] = turned[0, ::-1]
    with pytest.raises(InvalidInput, match="one orientation"):
        cap("ball", vertices, turned)


def test_a_dent_pushed_through_the_other_side_is_refused(sphere: tuple[FloatArray, IntArray]) -> None:
    vertices, faces = sphere
    pushed = vertices.copy()
    pushed[0] *= -1.5
    with pytest.raises(InvalidInput, match="crossing triangles"):
        check_closed("ball", pushed, faces)
