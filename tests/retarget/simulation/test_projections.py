import numpy as np
import pytest

from retarget.simulation import local_step
from retarget.simulation.projections import (
    closest_area,
    closest_rotation,
    closest_unit_determinant,
    signed_svd,
    unit_product,
)


def rotations(rng, count):
    q, r = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None]
    return q * np.sign(np.linalg.det(q))[:, None, None]


def gradients():
    """Mild, strong, inverted, flat, line-like and collapsed deformations."""
    rng = np.random.default_rng(0)
    mild = rotations(rng, 200) + 0.1 * rng.normal(size=(200, 3, 3))
    strong = rng.normal(size=(200, 3, 3))
    sigma = np.array(
        [[1, 1, 0], [2, 0, 0], [0, 0, 0], [1, 1, -1], [2, 2, 2], [3, 3, 3], [4, 4, 0.5], [1, 1, 1], [9, 8, 7]]
    )
    shaped = rotations(rng, 9) * sigma[:, None] @ rotations(rng, 9)
    return np.concatenate([mild, strong, shaped, 5 * strong[:50], 1e-3 * strong[:50]])


def squared(a, b):
    return ((a - b) ** 2).sum(axis=(-2, -1))


def test_signed_svd():
    f = gradients()
    u, sigma, vt = signed_svd(f)
    np.testing.assert_allclose((u * sigma[:, None]) @ vt, f, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(u), 1)
    np.testing.assert_allclose(np.linalg.det(vt), 1)
    assert (sigma[:, 0] >= sigma[:, 1]).all()
    assert (sigma[:, 1] >= np.abs(sigma[:, 2])).all()


def project(f):
    """The kernel over batches of LANES matrices; determinants (t,), rotations and unit determinants (t, 3, 3)."""
    lanes = local_step.LANES
    padded = np.concatenate([f, np.broadcast_to(np.eye(3, dtype=f.dtype), (-len(f) % lanes, 3, 3))]).reshape(
        -1, lanes, 9
    )
    r, d = np.empty((2, len(padded), 9, lanes), f.dtype)
    det, far, near = np.empty((3, len(padded), lanes), f.dtype)
    for i, tile in enumerate(padded):
        local_step.project(np.ascontiguousarray(tile.T), r[i], d[i], det[i], far[i], near[i])
    r, d = (np.swapaxes(m, 1, 2).reshape(-1, 3, 3)[: len(f)] for m in (r, d))
    return det.ravel()[: len(f)], r, d


def test_no_sampled_rotation_is_closer():
    f = gradients()
    r = closest_rotation(f)
    np.testing.assert_allclose(r @ np.swapaxes(r, 1, 2), np.broadcast_to(np.eye(3), r.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(r), 1)
    rng = np.random.default_rng(1)
    near = closest_rotation(r[:, None] + 0.1 * rng.normal(size=(len(f), 100, 3, 3)))
    assert (squared(f, r)[:, None] <= squared(f[:, None], near) + 1e-12).all()
    assert (squared(f, r)[:, None] <= squared(f[:, None], rotations(rng, 500)) + 1e-12).all()


def test_no_sampled_matrix_of_unit_determinant_is_closer():
    f = gradients()
    d = closest_unit_determinant(f)
    np.testing.assert_allclose(np.linalg.det(d), 1, atol=1e-9)
    rng = np.random.default_rng(1)
    for centre, spread in ((d, 0.02), (d, 0.2), (f, 0.2), (f, 1.0)):
        near = centre[:, None] + spread * rng.normal(size=(len(f), 200, 3, 3))
        determinant = np.linalg.det(near)
        near = near / np.cbrt(determinant)[..., None, None]
        assert (squared(f, d)[:, None] <= squared(f[:, None], near) + 1e-9).all()


def test_the_closest_product_of_one_against_a_dense_search():
    """Two singular values on a grid, the third from the constraint: the whole feasible set."""
    sigma = np.array(
        [[1.2, 1, 0.9], [1.5, 1.5, 1.5], [1.9, 1.9, 1.9], [2, 2, 2], [3, 3, 3], [4, 4, 0.5], [1, 0.5, -0.4], [5, 2, 2]]
    )
    grid = np.geomspace(0.02, 20, 1500)
    a, b = np.meshgrid(grid, grid)
    for s, d in zip(sigma, unit_product(sigma), strict=True):
        least = ((a - s[0]) ** 2 + (b - s[1]) ** 2 + (1 / (a * b) - s[2]) ** 2).min()
        assert least - 2e-3 < ((d - s) ** 2).sum() <= least


def test_uniform_expansion_beyond_two_is_not_closest_to_a_rotation():
    np.testing.assert_allclose(unit_product(np.array([[1.5, 1.5, 1.5]])), np.ones((1, 3)))
    three = unit_product(np.array([[3.0, 3.0, 3.0]]))[0]
    assert ((three - 3) ** 2).sum() < 12
    assert three[2] < 0.2 < 2.5 < three[1]


def test_kernels_agree_with_the_reference():
    f = gradients()
    f = f[np.abs(np.linalg.det(f)) > 0]  # where the projections are unique
    rotation, unit = closest_rotation(f), closest_unit_determinant(f)
    _, sigma, _ = signed_svd(f)
    unique = sigma[:, 1] + sigma[:, 2] > 1e-3
    det, r, d = project(f)
    np.testing.assert_allclose(det, np.linalg.det(f), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(d), 1, atol=1e-8)
    np.testing.assert_allclose(squared(f, d), squared(f, unit), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(squared(f, r), squared(f, rotation), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(r[unique], rotation[unique], atol=1e-7)


def test_the_svd_of_the_kernels():
    for matrix in gradients():
        u, sigma, v = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
        local_step.signed_svd(matrix, u, sigma, v)
        np.testing.assert_allclose((u * sigma) @ v.T, matrix, atol=1e-12)
        np.testing.assert_allclose(sigma, signed_svd(matrix[None])[1][0], atol=1e-12)
        np.testing.assert_allclose([np.linalg.det(u), np.linalg.det(v)], 1)


def test_no_sampled_triangle_of_the_wanted_area_is_closer():
    rng = np.random.default_rng(0)
    f = rng.normal(size=(60, 3, 2))
    f[0], f[1], f[2] = 0, [[1, 1], [2, 2], [0, 0]], [[1, 0], [0, 1], [0, 0]]
    f[3] = 3 * f[2]
    for wanted in (0.0, 0.3, 1.0, 2.5):
        d = closest_area(f, np.full(60, wanted))
        sigma = np.linalg.svd(d, compute_uv=False)
        np.testing.assert_allclose(sigma.prod(axis=1), wanted, atol=1e-9)
        for centre, spread in ((d, 0.02), (d, 0.3), (f, 1.0)):
            near = centre[:, None] + spread * rng.normal(size=(60, 300, 3, 2))
            u, s, vt = np.linalg.svd(near, full_matrices=False)
            s[..., 1] = wanted / s[..., 0]
            near = (u * s[..., None, :]) @ vt
            assert (squared(f, d)[:, None] <= squared(f[:, None], near) + 1e-9).all()


def test_a_triangle_of_the_wanted_area_stays():
    f = np.random.default_rng(0).normal(size=(40, 3, 2))
    np.testing.assert_allclose(closest_area(f, np.linalg.svd(f, compute_uv=False).prod(axis=1)), f, atol=1e-12)


@pytest.mark.parametrize(("real", "tolerance"), [(np.float64, 1e-9), (np.float32, 3e-5)])
def test_the_kernel_finds_the_global_minimum_of_mild_strong_expanded_and_inverted_matrices(real, tolerance):
    rng = np.random.default_rng(5)
    f = np.concatenate(
        [np.eye(3) + spread * rng.normal(size=(2000, 3, 3)) for spread in (0.1, 0.3, 0.8, 1.5)]
        + [scale * np.eye(3) + 0.3 * rng.normal(size=(1000, 3, 3)) for scale in (0.4, 1.4, 1.8, 2.7)]
    )
    _, r, d = project(f.astype(real))
    np.testing.assert_allclose(squared(f, r), squared(f, closest_rotation(f)), atol=tolerance)
    np.testing.assert_allclose(squared(f, d), squared(f, closest_unit_determinant(f)), atol=tolerance)
