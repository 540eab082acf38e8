"""Triangles that pass through each other, against all pairs tried one by one."""

from __future__ import annotations

import numpy as np
import trimesh

from retarget.anatomy.crossings import self_intersections
from retarget.types import FloatArray, IntArray


def _every_pair(vertices: FloatArray, faces: IntArray) -> set[tuple[int, int]]:
    """Pairs of triangles: an edge of the first, which has no vertex of the second, passes through the second."""
    found = set()
    for i, one in enumerate(faces):
        for edge in (one[[0, 1]], one[[1, 2]], one[[2, 0]]):
            p, q = vertices[edge]
            for j, other in enumerate(faces):
                if set(edge.tolist()) & set(other.tolist()):
                    continue
                a, b, c = vertices[other]
                system = np.column_stack([q - p, a - b, a - c])  # p + r (q - p) = a + s (b - a) + t (c - a)
                if abs(np.linalg.det(system)) > 1e-9:
                    r, s, t = np.linalg.solve(system, a - p)
                    if 0 < r < 1 and s > 0 and t > 0 and s + t < 1:
                        found.add((i, j))
    return found


def test_the_pairs_are_those_of_a_search_through_all() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=10.0)
    faces = np.array(ball.faces, dtype=np.int64)
    for seed in range(4):
        vertices = np.array(ball.vertices) + np.random.default_rng(seed).normal(0, 4.0, ball.vertices.shape)
        pairs = self_intersections(vertices, faces)
        assert len(pairs) > 20
        found, every = {(i, j) for i, j in pairs.tolist()}, _every_pair(vertices, faces)
        assert found <= every  # an edge of two triangles is named with one of them
        assert {j for _, j in found} == {j for _, j in every}


def test_crossing_triangles_are_found_and_only_those() -> None:
    flat = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])
    through = np.array([[1.0, 1, -1], [1, 1, 1], [5, 5, 1]])
    above = flat + np.array([0, 0, 2.5])
    faces = np.arange(9, dtype=np.int64).reshape(3, 3)
    pairs = self_intersections(np.vstack([flat, through, above]), faces)
    assert {frozenset(pair) for pair in pairs.tolist()} == {frozenset({0, 1})}


def test_triangles_of_very_different_size_are_compared() -> None:
    large = np.array([[-100.0, -100, 0], [100, -100, 0], [0, 150, 0]])
    small = np.array([[0.0, 0, -0.1], [0.1, 0, 0.1], [0, 0.1, 0.1]])
    faces = np.arange(6, dtype=np.int64).reshape(2, 3)
    assert len(self_intersections(np.vstack([large, small]), faces)) == 1
    assert len(self_intersections(np.vstack([large, small + np.array([0, 0, 1])]), faces)) == 0


def test_triangles_in_one_plane_do_not_cross_by_rounding() -> None:
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    grid = np.stack(np.meshgrid(np.arange(30.0), np.arange(30.0), [0.0]), axis=-1).reshape(-1, 3) @ turn.T + 600.0
    at = np.arange(900).reshape(30, 30)
    low, high = (at[:-1, :-1], at[:-1, 1:], at[1:, 1:]), (at[:-1, :-1], at[1:, 1:], at[1:, :-1])
    faces = np.concatenate([np.stack([c.ravel() for c in half], axis=1) for half in (low, high)])
    moved = np.array([0.5, 0.0, 0.0]) @ turn.T
    twice = np.vstack([grid, grid + moved])
    assert len(self_intersections(twice, np.vstack([faces, faces + 900]))) == 0
