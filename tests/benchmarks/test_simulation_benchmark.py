"""The simulation's inner loop at the size of the paper's template, each part beside a naive version of itself.

A plate of 60,492 vertices and 238,572 tets with 50,410 free vertices stands in for the tissue layer: the skull holds
half of its lower side, the skin is its upper side.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from retarget.anatomy.head import Head
from retarget.anatomy.store import load_template
from retarget.simulation.inverse import InverseSettings, InverseSimulation
from retarget.simulation.local_step import TetrahedralEnergy
from retarget.simulation.projections import closest_rotation, signed_svd, unit_product
from retarget.simulation.projective_dynamics import (
    LENGTH_UNIT,
    ProjectiveDynamics,
    SolverSettings,
    TissueWeights,
    tissue_weights,
)
from retarget.simulation.tetrahedra import RestShape, deformation_gradients, gradient_operator, rest_shape
from retarget.types import FloatArray, IntArray
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head
from synth_data.sequence import sparse_weights
from tests.retarget.simulation.box import box

W_TAR = 100.0
ONE_ITERATION = SolverSettings(max_iterations=1)


class Plate:
    def __init__(self) -> None:
        vertices, tets = box((141, 141, 2), (150.0, 150.0, 8.0))
        self.shape: RestShape = rest_shape(vertices, tets)
        self.skull: IntArray = np.flatnonzero((vertices[:, 2] == 0) & (vertices[:, 0] < 75))
        skin = np.flatnonzero(vertices[:, 2] == 8)
        rows = np.arange(len(skin))
        self.operator = sp.csr_array((np.ones(len(skin)), (rows, skin)), shape=(len(skin), len(vertices)))
        self.weights: TissueWeights = tissue_weights(self.shape, vertices[tets].mean(axis=1)[:, 2] < 4)
        bump = 4 * np.exp(-((vertices[:, :2] - 75) ** 2).sum(axis=1) / 400)
        self.targets: FloatArray = vertices[skin] + np.array([0.3, 0, 1]) * bump[skin, None]
        self.moved: FloatArray = vertices + np.array([0.3, 0, 1]) * (bump * vertices[:, 2] / 8)[:, None]

    def solver(self, settings: SolverSettings) -> ProjectiveDynamics:
        return ProjectiveDynamics(self.shape, self.weights, self.skull, self.operator, W_TAR, settings)


class NaiveIteration:
    """One iteration with scipy alone: a kept LU factor with scipy's default ordering and numpy's batched SVD."""

    def __init__(self, plate: Plate) -> None:
        self.plate = plate
        self.gradient = gradient_operator(plate.shape)
        self.free = np.setdiff1d(np.arange(len(plate.shape.vertices)), plate.skull)
        w = plate.weights
        pull = plate.operator.T @ plate.operator * (W_TAR / LENGTH_UNIT**2)
        matrix = self.gradient.T @ sp.diags_array(np.repeat(w.strain + w.volume, 3)) @ self.gradient + pull
        self.factor = splu(sp.csc_array(sp.csr_array(matrix)[self.free][:, self.free]))

    def local(self, x: FloatArray) -> FloatArray:
        w = self.plate.weights
        f = deformation_gradients(self.plate.shape, x)
        u, sigma, vt = signed_svd(f)
        r, d = u @ vt, (u * unit_product(sigma)[:, None]) @ vt
        pull = w.strain[:, None, None] * (r - f) + w.volume[:, None, None] * (d - f)
        descent: FloatArray = self.gradient.T @ np.swapaxes(pull, 1, 2).reshape(-1, 3)
        return descent

    def __call__(self, x: FloatArray) -> FloatArray:
        miss = self.plate.targets - self.plate.operator @ x
        descent = self.local(x) + self.plate.operator.T @ miss * (W_TAR / LENGTH_UNIT**2)
        moved = x.copy()
        moved[self.free] += self.factor.solve(descent[self.free])
        return moved


@pytest.fixture(scope="module")
def plate() -> Plate:
    return Plate()


@pytest.mark.benchmark(group="local step, 239k tets")
@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
def test_local_step(benchmark, plate, single):
    energy = TetrahedralEnergy(plate.shape, plate.weights.strain, plate.weights.volume, single)
    step = benchmark.pedantic(energy, (plate.moved,), rounds=30, warmup_rounds=2)
    expected = NaiveIteration.local(_without_factor(plate), plate.moved)
    np.testing.assert_allclose(step.descent, expected, atol=(1e-4 if single else 1e-6) * np.abs(expected).max())


def _without_factor(plate: Plate) -> NaiveIteration:
    naive = NaiveIteration.__new__(NaiveIteration)
    naive.plate, naive.gradient = plate, gradient_operator(plate.shape)
    return naive


@pytest.mark.benchmark(group="local step, 239k tets")
def test_local_step_naive(benchmark, plate):
    benchmark.pedantic(_without_factor(plate).local, (plate.moved,), rounds=3)


@pytest.mark.benchmark(group="local step, 239k tets")
def test_rotations_by_batched_svd(benchmark, plate):
    f = deformation_gradients(plate.shape, plate.moved)
    benchmark.pedantic(closest_rotation, (f,), rounds=3)


@pytest.mark.benchmark(group="one inverse iteration, 50k free vertices, 239k tets")
def test_one_iteration(benchmark, plate):
    """Global step and the local step of its result: an iteration without the evaluation of the start."""
    solver = plate.solver(ONE_ITERATION)
    x = plate.moved[solver._order]
    descent = solver._evaluate(x, plate.targets, None).descent

    def iterate():
        moved = x.copy()
        moved[: len(solver.free)] += solver._factor.solve(descent)
        return moved, solver._evaluate(moved, plate.targets, None)

    moved, _ = benchmark.pedantic(iterate, rounds=30, warmup_rounds=2)
    np.testing.assert_allclose(moved[solver._place], NaiveIteration(plate)(plate.moved), atol=1e-4)


@pytest.mark.benchmark(group="one inverse iteration, 50k free vertices, 239k tets")
def test_one_iteration_naive(benchmark, plate):
    benchmark.pedantic(NaiveIteration(plate), (plate.moved,), rounds=3)


@pytest.mark.benchmark(group="inverse simulation, 50k free vertices, 239k tets")
@pytest.mark.parametrize("depth", [0, 5])
def test_inverse_simulation(benchmark, plate, depth):
    solver = plate.solver(replace(SolverSettings(), anderson_depth=depth))
    result = benchmark.pedantic(solver.solve, (plate.targets,), rounds=3, warmup_rounds=1)
    benchmark.extra_info["iterations"] = result.info.iterations


@pytest.mark.benchmark(group="set-up of the inverse simulation, 50k free vertices, 239k tets")
def test_set_up(benchmark, plate):
    benchmark.pedantic(plate.solver, (SolverSettings(),), rounds=3)


class Animated:
    """MakeHuman's head as it was meshed, at the paper's size, and 60 frames through expressions of many units."""

    def __init__(self) -> None:
        base, targets = load_head()
        fine = subdivide(base.faces, len(base.vertices))
        regions = fine.regions(load_regions())
        template = load_template(fine.faces, regions, "paper")
        condyles = np.array([regions.points[f"condyle_{side}"](template.skin) for side in ("left", "right")])
        self.head = Head(template, template.skin, template.vertices, condyles, {})
        keys = np.vstack([np.zeros((1, len(SKIN_NAMES))), sparse_weights(6, seed=3)])
        times = np.linspace(0, 6, 61)[1:]
        weights = np.stack([np.interp(times, range(7), keys[:, unit]) for unit in range(len(SKIN_NAMES))], axis=1)
        units = fine(np.stack([targets[f"units/{name}"] for name in SKIN_NAMES]))
        self.skins: FloatArray = template.skin + np.einsum("tu,unc->tnc", weights, units)


@pytest.fixture(scope="module")
def animated() -> Animated:
    return Animated()


@pytest.mark.benchmark(group="inverse simulation of an animation, paper template, one expression")
@pytest.mark.parametrize("surface", ["soft", "hard"])
def test_stream(benchmark, animated, surface):
    simulation = InverseSimulation(animated.head, InverseSettings(surface=surface))
    states = simulation.stream(animated.skins)
    next(states)
    iterations = benchmark.pedantic(lambda: next(states).info.iterations, rounds=len(animated.skins) - 1)
    benchmark.extra_info["iterations of the last"] = iterations


@pytest.mark.benchmark(group="inverse simulation of 16 expressions, paper template")
@pytest.mark.parametrize(("backend", "size"), [("cholespy", 1), ("cholespy", 16), ("dissection", 16)])
def test_batch(benchmark, animated, backend, size):
    settings = InverseSettings()
    simulation = InverseSimulation(animated.head, replace(settings, solver=replace(settings.solver, backend=backend)))
    benchmark.pedantic(simulation.batch, (animated.skins[9::4][:16], size), rounds=2)
