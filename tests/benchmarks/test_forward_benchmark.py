"""The forward simulation at the size of the paper's template, and a collision set beside refactorising for it.

A block of 45,000 vertices and 236,544 tets with a mouth of 1,200 points stands in for the head.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from retarget.anatomy.head import Head
from retarget.simulation.bones import pivot
from retarget.simulation.characteristics import FacialCharacteristics
from retarget.simulation.collisions import TRIGGER
from retarget.simulation.condensed import SoftProblem, SoftRows, SoftSystem
from retarget.simulation.factor import factorise
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.state import Bones, RigidMotion
from retarget.simulation.tetrahedra import deformation_gradients
from retarget.types import FloatArray, Pair
from tests.retarget.simulation.box_head import box_head, box_template
from tests.retarget.simulation.test_bones import turn
from tests.retarget.simulation.test_forward import moved

GROUP = "forward simulation, 236,544 tets"


class Block:
    """A head, an expression of it with closed and with crossed lips, and characteristics that it does not meet."""

    def __init__(self) -> None:
        self.head: Head = box_head(box_template((64, 56, 11)))
        self.forward = ForwardSimulation(self.head)
        self.heedless = ForwardSimulation(self.head, ForwardSettings(collisions=False))
        vertices, self.open = moved(self.head)
        self.gradients: FloatArray = deformation_gradients(self.forward.shape, vertices)
        lift = RigidMotion(turn("x", -3.0), np.array([0, 1.5, 0]), pivot(self.head))
        self.crossed = Bones(self.open.cranium, lift)
        other = box_head(self.head.template, np.diag([1.1, 0.95, 1.0]) + 0.03)
        pair = Pair(self.head.template.faces, other.skin, self.head.skin, self.head.template.regions)
        fc = FacialCharacteristics(pair)
        self.characteristics = fc(other.skin + np.sin(other.skin[:, [1, 2, 0]] / 9))
        self.still: FloatArray = np.broadcast_to(np.eye(3), self.gradients.shape)
        self.calm = replace(fc(other.skin), lip_contour=None)  # it would keep the lips apart


@pytest.fixture(scope="module")
def block() -> Block:
    return Block()


@pytest.mark.benchmark(group=GROUP)
def test_set_up(benchmark, block):
    forward = benchmark.pedantic(ForwardSimulation, (block.head,), rounds=2)
    benchmark.extra_info["points"] = len(forward._system.compliance)
    benchmark.extra_info["compliance_mib"] = forward._system.compliance.nbytes / 2**20


@pytest.mark.benchmark(group=GROUP)
def test_set_up_without_collisions(benchmark, block):
    benchmark.pedantic(ForwardSimulation, (block.head, ForwardSettings(collisions=False)), rounds=2)


@pytest.mark.benchmark(group=GROUP)
def test_frame(benchmark, block):
    run = (block.gradients, block.open, 1.0, block.characteristics)
    state = benchmark.pedantic(block.heedless, run, rounds=30, warmup_rounds=2)
    benchmark.extra_info["area_iterations"] = state.info.iterations


@pytest.mark.benchmark(group=GROUP)
def test_frame_with_lip_collisions(benchmark, block):
    state = benchmark.pedantic(block.forward, (block.still, block.crossed, 1.0, block.calm), rounds=30, warmup_rounds=2)
    assert state.lips.contacts > 0
    assert state.lips.after < 0.1 < state.lips.before
    benchmark.extra_info.update(contacts=state.lips.contacts, rounds=state.lips.rounds, before=state.lips.before)


@pytest.mark.benchmark(group=GROUP)
def test_lip_depth(benchmark, block):
    skin = block.heedless(block.still, block.crossed).skin
    assert benchmark.pedantic(block.forward._lips.depth, (skin,), rounds=30, warmup_rounds=2) > 0.1


@pytest.mark.benchmark(group=GROUP)
def test_lip_detection(benchmark, block):
    lips = block.forward._lips
    points = block.heedless(block.still, block.crossed).skin[lips.vertices]
    found = benchmark.pedantic(lips.gaps, (points,), rounds=30, warmup_rounds=2)
    benchmark.extra_info["samples"] = lips.samples.count
    assert found.gap.min() < -0.1


class Contact:
    """What changes when lips meet: rows from samples to where they meet the other lip, and their goals, 0."""

    def __init__(self, block: Block) -> None:
        forward = block.forward
        free = block.heedless(block.still, block.crossed)
        lips = forward._lips
        found = lips.gaps(free.skin[lips.vertices])
        use = np.flatnonzero(lips.floor - found.gap > TRIGGER)
        columns = lips.vertices[np.hstack([lips.samples.corners[use], found.corners[use]])]
        values = np.hstack([lips.samples.weights[use], -found.weights[use]])
        shape = len(use), len(block.head.skin)
        self.onto_skin = sp.csr_array((values.ravel(), columns.ravel(), 6 * np.arange(len(use) + 1)), shape=shape)
        self.goals = np.zeros((len(use), 3))
        self.weight = 10 / np.mean(np.diag(forward._system.compliance))
        self.points = forward._terms.points @ free.vertices + forward._terms.offset
        self.free = free.vertices


@pytest.fixture(scope="module")
def contact(block):
    return Contact(block)


@pytest.mark.benchmark(group="one more collision set, 236,544 tets")
def test_collision_set(benchmark, block, contact):
    """The dense system extended by the set, its solution, and the back-substitution to all vertices."""
    system, terms = block.forward._system, block.forward._terms
    none = SoftRows.stack([], len(terms.skin))
    calm = SoftSystem(system, none, none)

    def resolve() -> FloatArray:
        rows = SoftRows(contact.onto_skin[:, terms.skin], np.full(len(contact.goals), contact.weight))
        solution = calm.with_fixed(rows).solve(SoftProblem(contact.points, contact.goals, np.empty(0)))
        return contact.free[block.forward._free] + system.pulled(solution.forces)

    found = benchmark.pedantic(resolve, rounds=20, warmup_rounds=2)
    benchmark.extra_info["contacts"] = len(contact.goals)
    np.testing.assert_allclose(found, refactorised(block, contact), atol=1e-8)


@pytest.mark.benchmark(group="one more collision set, 236,544 tets")
def test_collision_set_by_refactorising(benchmark, block, contact):
    benchmark.pedantic(refactorised, (block, contact), rounds=3)


def refactorised(block: Block, contact: Contact) -> FloatArray:
    """The same with the contacts in the matrix, which is factorised for them."""
    forward = block.forward
    rows = sp.csr_array(contact.onto_skin @ block.head.template.embedding)
    goals = contact.goals - contact.onto_skin @ block.head.residual
    matrix = forward._tissue.matrix() + contact.weight * (rows.T @ rows)
    load = forward._tissue.divergence(block.still) + contact.weight * (rows.T @ goals)
    free, fixed = forward._free, forward._fixed
    inner = sp.csr_array(matrix)[free]
    return factorise(inner[:, free]).solve(load[free] - inner[:, fixed] @ contact.free[fixed])
