"""Smoothing by heat: what stays, and how far it spreads."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from retarget.geometry.laplacian import heat, surface_energies
from retarget.types import FloatArray, IntArray


def _square(count: int, side: float = 60.0) -> tuple[FloatArray, IntArray]:
    """A flat square of `side` mm with count x count vertices."""
    at = np.linspace(-side / 2, side / 2, count)
    vertices = np.stack(np.meshgrid(at, at, [0.0]), axis=-1).reshape(-1, 3)
    grid = np.arange(count * count).reshape(count, count)
    a, b, c, d = (grid[i : count - 1 + i, j : count - 1 + j].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


@pytest.mark.parametrize("count", [31, 61, 121])
def test_heat_spreads_by_its_width_at_every_resolution(count: int) -> None:
    vertices, faces = _square(count)
    _, mass = surface_energies(vertices, faces)
    spot = np.zeros(len(vertices))
    spot[len(vertices) // 2] = 1.0
    spread = mass * heat(vertices, faces, 4.0)(spot)
    deviation = np.sqrt((spread[:, None] * vertices[:, :2] ** 2).sum(axis=0) / spread.sum())
    assert deviation == pytest.approx([4.0, 4.0], rel=0.03)  # but for what the border reflects


def test_heat_keeps_constants_the_sum_and_the_range() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=50.0)
    vertices, faces = np.array(sphere.vertices), np.array(sphere.faces)
    vertices = vertices * np.random.default_rng(0).uniform(0.7, 1.3, (len(vertices), 1))  # obtuse triangles
    _, mass = surface_energies(vertices, faces)
    smoothed = heat(vertices, faces, 8.0)
    assert smoothed(np.full(len(vertices), 0.3)) == pytest.approx(0.3, abs=1e-12)
    steps = (vertices[:, 0] > 0).astype(float)
    after = smoothed(steps)
    assert mass @ after == pytest.approx(mass @ steps, rel=1e-12)
    assert 0 <= after.min() < after.max() <= 1
    assert np.ptp(after[np.abs(vertices[:, 0]) < 5]) < 1
