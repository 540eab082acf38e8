"""Deformation transfer and patchwise blendshapes at the size of a study, each beside a naive version of itself."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import BlendshapeTransfer, Ridge
from retarget.rig.deformation_transfer import DeformationTransfer
from retarget.types import FloatArray, IntArray
from tests.retarget.rig.literal_deformation_transfer import source_gradients, system

EXAMPLES, FRAMES, PATCHES = 30, 250, 80
LAMBDA = 0.01


def sphere_grid(rings: int, sectors: int) -> tuple[FloatArray, IntArray]:
    """A closed ellipsoid of a head's size with rings * sectors + 2 vertices."""
    polar = np.linspace(0, np.pi, rings + 2)[1:-1, None]
    around = np.linspace(0, 2 * np.pi, sectors, endpoint=False)[None]
    body = np.stack([np.sin(polar) * np.sin(around), np.cos(polar) + 0 * around, np.sin(polar) * np.cos(around)], -1)
    directions = np.vstack([body.reshape(-1, 3), [[0, 1, 0], [0, -1, 0]]])
    grid = np.arange(rings * sectors).reshape(rings, sectors)
    a, b = grid[:-1], np.roll(grid, -1, axis=1)[:-1]
    c, d = grid[1:], np.roll(grid, -1, axis=1)[1:]
    top, bottom = rings * sectors, rings * sectors + 1
    faces = [
        np.stack([a, c, d], -1).reshape(-1, 3),
        np.stack([a, d, b], -1).reshape(-1, 3),
        np.stack([0 * grid[0] + top, grid[0], np.roll(grid[0], -1)], -1),
        np.stack([grid[-1], 0 * grid[0] + bottom, np.roll(grid[-1], -1)], -1),
    ]
    return directions * [75, 110, 95], np.vstack(faces)


def perform(neutral: FloatArray, count: int, seed: int) -> FloatArray:
    """(count, n, 3) mm: smooth motions of the front, of some mm."""
    rng = np.random.default_rng(seed)
    waves = np.sin(neutral @ rng.normal(0, 0.03, (3, 12)) + rng.uniform(0, 6, 12)) * (neutral[:, 2:] > 0)
    return neutral + np.einsum("nw,cwd->cnd", waves, rng.normal(0, 1, (count, 12, 3)))


@pytest.fixture(scope="module")
def heads_11k() -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Two neutrals of 11,250 vertices and 22,496 triangles, and 16 expressions of the first."""
    source, faces = sphere_grid(74, 152)
    target = source * [1.1, 0.95, 1.0] + 3 * np.sin(source[:, [1, 2, 0]] / 20)
    return source, target, faces, perform(source, 16, 0)


@pytest.fixture(scope="module")
def blendshapes_17k() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[IntArray, ...], FloatArray]:
    """30 corresponding examples and 250 source frames of two heads of 17,002 vertices, and their patches."""
    source, faces = sphere_grid(100, 170)
    target = source * [1.1, 0.95, 1.0]
    frames = perform(source, FRAMES, 1)
    examples = perform(source, EXAMPLES, 2), perform(target, EXAMPLES, 3)
    return source, examples[0], target, examples[1], contiguous_patches(faces, len(source), PATCHES), frames


class NaiveDeformationTransfer:
    """The system of 2004 as written, fourth vertices included, without keeping a factor between expressions."""

    def __init__(self, source: FloatArray, target: FloatArray, faces: IntArray) -> None:
        self.source, self.faces, self.n = source, faces, len(target)
        matrix = system(target, faces).tocsc()
        self.matrix = matrix[:, 1:]  # the first vertex is pinned
        self.pinned = matrix[:, [0]] @ target[:1]

    def __call__(self, expression: FloatArray) -> FloatArray:
        gradients = source_gradients(self.source, expression, self.faces) - self.pinned
        normal = sp.csc_matrix(self.matrix.T @ self.matrix)
        factor = splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return factor.solve(self.matrix.T @ gradients)[: self.n - 1]


def naive_plbs(source, source_examples, target, target_examples, patches, frame):
    """Eq. (2) as a stacked least-squares problem for each patch and frame."""
    moved = target.copy()
    for patch in patches:
        basis = (source_examples - source)[:, patch].reshape(EXAMPLES, -1).T
        rows = np.vstack([basis, np.sqrt(LAMBDA * len(patch)) * np.eye(EXAMPLES)])
        wanted = np.r_[(frame - source)[patch].ravel(), np.zeros(EXAMPLES)]
        weights, *_ = np.linalg.lstsq(rows, wanted, rcond=None)
        moved[patch] += np.tensordot(weights, (target_examples - target)[:, patch], 1)
    return moved


@pytest.mark.benchmark(group="deformation transfer, set-up, 11k vertices")
def test_deformation_transfer_set_up(benchmark, heads_11k):
    source, target, faces, _ = heads_11k
    benchmark.pedantic(DeformationTransfer, (source, target, faces, [0]), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group="deformation transfer, set-up, 11k vertices")
def test_deformation_transfer_set_up_naive(benchmark, heads_11k):
    source, target, faces, _ = heads_11k
    benchmark.pedantic(NaiveDeformationTransfer, (source, target, faces), rounds=1)


@pytest.mark.benchmark(group="deformation transfer, one expression, 11k vertices")
def test_deformation_transfer_one_expression(benchmark, heads_11k):
    source, target, faces, frames = heads_11k
    benchmark(DeformationTransfer(source, target, faces, [0]), frames[:1])


@pytest.mark.benchmark(group="deformation transfer, 16 expressions, 11k vertices")
def test_deformation_transfer_sixteen_expressions(benchmark, heads_11k):
    source, target, faces, frames = heads_11k
    benchmark(DeformationTransfer(source, target, faces, [0]), frames)


@pytest.mark.benchmark(group="deformation transfer, one expression, 11k vertices")
def test_deformation_transfer_one_expression_naive(benchmark, heads_11k):
    source, target, faces, frames = heads_11k
    naive = NaiveDeformationTransfer(source, target, faces)
    literal = benchmark.pedantic(naive, (frames[0],), rounds=1)
    ours = DeformationTransfer(source, target, faces, [0])(frames[:1])[0, 1:]
    np.testing.assert_allclose(literal - literal.mean(axis=0), ours - ours.mean(axis=0), atol=1e-5)


@pytest.mark.benchmark(group="PLBS, set-up, 30 examples, 17k vertices")
def test_plbs_set_up(benchmark, blendshapes_17k):
    *pair, patches, _ = blendshapes_17k
    benchmark.pedantic(BlendshapeTransfer, (*pair, patches, Ridge(LAMBDA)), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group="PLBS, 250 expressions, 30 examples, 17k vertices")
def test_plbs_250_expressions(benchmark, blendshapes_17k):
    *pair, patches, frames = blendshapes_17k
    benchmark.pedantic(BlendshapeTransfer(*pair, patches, Ridge(LAMBDA)), (frames,), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group="PLBS, one expression, 30 examples, 17k vertices")
def test_plbs_one_expression(benchmark, blendshapes_17k):
    *pair, patches, frames = blendshapes_17k
    benchmark(BlendshapeTransfer(*pair, patches, Ridge(LAMBDA)), frames[:1])


@pytest.mark.benchmark(group="PLBS, one expression, 30 examples, 17k vertices")
def test_plbs_one_expression_naive(benchmark, blendshapes_17k):
    *pair, patches, frames = blendshapes_17k
    literal = benchmark.pedantic(naive_plbs, (*pair, patches, frames[0]), rounds=2)
    ours = BlendshapeTransfer(*pair, patches, Ridge(LAMBDA))(frames[:1]).target[0]
    np.testing.assert_allclose(literal, ours, atol=1e-6)
