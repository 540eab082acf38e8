"""Loop subdivision against trimesh's, its exact properties, and what it does to regions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from retarget.types import FloatArray, IntArray, Regions
from synth_data.makehuman.subdivide import subdivide


@pytest.fixture
def open_mesh() -> tuple[FloatArray, IntArray]:
    """A bumpy grid with a rim and vertices of valence 4 and 6."""
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0))
    v = np.stack([x, y, np.sin(2 * x) + np.cos(y)], axis=-1).reshape(-1, 3)
    i = np.arange(30).reshape(5, 6)
    a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
    return v, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def tube() -> tuple[FloatArray, IntArray]:
    """Two rims and no chord between rim vertices, where trimesh's rule would count it as a rim edge."""
    turn, z = np.meshgrid(2 * np.pi * np.arange(8) / 8, np.arange(5.0))
    v = np.stack([np.cos(turn) * (1 + z / 5), np.sin(turn), z], axis=-1).reshape(-1, 3)
    i = np.arange(40).reshape(5, 8)
    a, b = i[:-1].ravel(), np.roll(i, -1, axis=1)[:-1].ravel()
    d, c = i[1:].ravel(), np.roll(i, -1, axis=1)[1:].ravel()
    return v, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def sphere() -> tuple[FloatArray, IntArray]:
    mesh = trimesh.creation.icosphere(subdivisions=1)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


@pytest.mark.parametrize("steps", [1, 2])
@pytest.mark.parametrize("mesh", [tube, sphere])
def test_agrees_with_the_implementation_in_trimesh(mesh: Callable[[], tuple[FloatArray, IntArray]], steps: int) -> None:
    v, f = mesh()
    mine = subdivide(f, len(v), steps)
    fine = mine(v)
    theirs, their_faces = trimesh.remesh.subdivide_loop(v, f, iterations=steps)
    assert fine.shape == theirs.shape
    distance, index = trimesh.proximity.cKDTree(theirs).query(fine)
    assert distance.max() < 1e-12
    assert {tuple(sorted(t)) for t in index[mine.faces]} == {tuple(sorted(t)) for t in their_faces}


def test_reproduces_affine_maps_and_keeps_the_orientation(open_mesh: tuple[FloatArray, IntArray]) -> None:
    v, f = open_mesh
    step = subdivide(f, len(v), 2)
    linear, shift = np.array([[1.0, 0.2, 0], [0, 0.7, 0.1], [0.3, 0, 1.4]]), np.array([3.0, -1, 2])
    np.testing.assert_allclose(step(v @ linear.T + shift), step(v) @ linear.T + shift, atol=1e-12)
    flat = v * (1, 1, 0)
    fine = step(flat)
    a, b, c = (fine[step.faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_displacements_are_refined_like_positions(open_mesh: tuple[FloatArray, IntArray]) -> None:
    v, f = open_mesh
    step = subdivide(f, len(v))
    deltas = np.random.default_rng(0).standard_normal((4, *v.shape))
    np.testing.assert_allclose(step(v) + step(deltas), step(v + deltas), atol=1e-12)


def test_no_step_is_the_identity(open_mesh: tuple[FloatArray, IntArray]) -> None:
    v, f = open_mesh
    step = subdivide(f, len(v), 0)
    np.testing.assert_array_equal(step(v), v)
    np.testing.assert_array_equal(step.faces, f)
    regions = Regions(vertices={"a": np.arange(3)})
    np.testing.assert_array_equal(step.regions(regions).vertices["a"], np.arange(3))


def test_regions_on_two_triangles_by_hand() -> None:
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    coarse = Regions(
        vertices={"edge": np.array([1, 2]), "corners": np.array([0, 3])},
        loops={"first": np.array([0, 1, 2])},
        triangles={"second": np.array([1])},
        landmarks={"tip": 3},
        mirror=np.array([3, 1, 2, 0]),
    )
    step = subdivide(faces, 4)
    fine = step.regions(coarse)
    edges = [tuple(e) for e in step.edges[0]]
    assert edges == [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]
    np.testing.assert_array_equal(fine.vertices["edge"], [1, 2, 4 + 2])
    np.testing.assert_array_equal(fine.vertices["corners"], [0, 3])
    np.testing.assert_array_equal(fine.loops["first"], [0, 4, 1, 6, 2, 5])
    np.testing.assert_array_equal(fine.triangles["second"], [4, 5, 6, 7])
    assert fine.landmarks == {"tip": 3}
    np.testing.assert_array_equal(fine.mirror, [3, 1, 2, 0, 7, 8, 6, 4, 5])


def test_regions_after_two_steps_are_those_of_one_step_twice(open_mesh: tuple[FloatArray, IntArray]) -> None:
    v, f = open_mesh
    coarse = Regions(vertices={"a": np.arange(12)}, loops={"l": np.array([0, 1, 7])}, triangles={"t": np.array([0, 3])})
    once = subdivide(f, len(v))
    again = subdivide(once.faces, len(once(v)))
    both = subdivide(f, len(v), 2)
    np.testing.assert_array_equal(both.faces, again.faces)
    np.testing.assert_allclose(both(v), again(once(v)), atol=1e-12)
    expected, got = again.regions(once.regions(coarse)), both.regions(coarse)
    for kind in ("vertices", "loops", "triangles"):
        for name, members in getattr(expected, kind).items():
            np.testing.assert_array_equal(getattr(got, kind)[name], members)
