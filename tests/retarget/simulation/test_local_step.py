import numpy as np
import pytest

from retarget.simulation.local_step import TetrahedralEnergy, paper_energy
from retarget.simulation.projections import closest_rotation, closest_unit_determinant
from retarget.simulation.tetrahedra import deformation_gradients, gradient_operator, rest_shape
from tests.retarget.simulation.box import box
from tests.retarget.simulation.threads import with_one_and_two_threads


@pytest.fixture(scope="module")
def shape():
    return rest_shape(*box((5, 4, 3), (50.0, 40.0, 30.0)))


@pytest.fixture(scope="module")
def weights(shape):
    rng = np.random.default_rng(0)
    return shape.volumes * rng.uniform(0.5, 2, (2, len(shape.tets)))


@pytest.mark.parametrize("spread", [0.3, 1.5, 8.0])  # mm; the last inverts a third of the tets
@pytest.mark.parametrize(("single", "tolerance"), [(False, 1e-7), (True, 3e-5)])
def test_sums_agree_with_batched_svd(shape, weights, spread, single, tolerance):
    x = shape.vertices + spread * np.random.default_rng(1).normal(size=shape.vertices.shape)
    f = deformation_gradients(shape, x)
    r, d = closest_rotation(f), closest_unit_determinant(f)
    step = TetrahedralEnergy(shape, *weights, single)(x)
    assert step.strain == pytest.approx(weights[0] @ ((f - r) ** 2).sum(axis=(1, 2)), rel=tolerance)
    assert step.volume == pytest.approx(weights[1] @ ((f - d) ** 2).sum(axis=(1, 2)), rel=tolerance)
    assert step.inverted == (np.linalg.det(f) <= 0).sum()
    assert (step.inverted > 100) == (spread == 8.0)
    pull = weights[0][:, None, None] * (r - f) + weights[1][:, None, None] * (d - f)
    expected = gradient_operator(shape).T @ np.swapaxes(pull, 1, 2).reshape(-1, 3)
    np.testing.assert_allclose(step.descent, expected, atol=tolerance * np.abs(expected).max())


@pytest.mark.parametrize("term", [0, 1])
def test_descent_is_minus_half_the_gradient(shape, weights, term):
    only = [w * (i == term) for i, w in enumerate(weights)]
    energy = TetrahedralEnergy(shape, *only)
    rng = np.random.default_rng(2)
    x = shape.vertices + rng.normal(size=shape.vertices.shape)
    direction = rng.normal(size=x.shape)
    h = 1e-4
    slope = (energy(x + h * direction).energy - energy(x - h * direction).energy) / (2 * h)
    assert -2 * np.vdot(energy(x).descent, direction) == pytest.approx(slope, rel=1e-6)


def test_a_rigid_motion_has_no_energy_and_no_force(shape, weights):
    rotation = closest_rotation(np.random.default_rng(3).normal(size=(1, 3, 3)))[0]
    step = TetrahedralEnergy(shape, *weights)(shape.vertices @ rotation.T + [5, -3, 100])
    assert step.energy < 1e-20
    np.testing.assert_allclose(step.descent, 0, atol=1e-12)


@pytest.mark.parametrize("scale", [0.5, 0.9, 1.2, 1.5])
def test_uniform_scaling_has_the_known_energy(shape, weights, scale):
    """||s I - I||^2 = 3 (s - 1)^2 per unit of weight for both terms, and (s^3 - 1)^2 as printed in eq. (11)."""
    step = TetrahedralEnergy(shape, *weights)(scale * shape.vertices)
    assert step.strain == pytest.approx(weights[0].sum() * 3 * (scale - 1) ** 2)
    assert step.volume == pytest.approx(weights[1].sum() * 3 * (scale - 1) ** 2)
    f = deformation_gradients(shape, scale * shape.vertices)
    printed = weights[0].sum() * 3 * (scale - 1) ** 2 + weights[1].sum() * (scale**3 - 1) ** 2
    assert paper_energy(f, closest_rotation(f), *weights) == pytest.approx(printed)


def test_same_bits_for_any_number_of_threads(shape, weights):
    x = shape.vertices + np.random.default_rng(1).normal(size=shape.vertices.shape)
    energy = TetrahedralEnergy(shape, *weights)
    one, two = with_one_and_two_threads(lambda: energy(x))
    assert one.energy == two.energy
    np.testing.assert_array_equal(one.descent, two.descent)
