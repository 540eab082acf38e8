"""Closest matrices: what the local step of projective dynamics projects deformation gradients to.

Reference versions by batched SVD. The fused kernels of `local_step` are tested against them.
"""

from __future__ import annotations

import numpy as np

from retarget.types import FloatArray

BISECTIONS = 60  # halves an interval down to rounding


def signed_svd(gradients: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """U, sigma, V^T of matrices (t, 3, 3) with U and V rotations and sigma_1 >= sigma_2 >= |sigma_3|.

    The sign convention for inverted tets: det F < 0 makes the smallest singular value negative
    (Irving et al. 2004, section 5), so an inverted tet is pushed back the shortest way.
    """
    u, sigma, vt = np.linalg.svd(gradients)
    for rotation, axis in ((u, np.s_[..., :, 2]), (vt, np.s_[..., 2, :])):
        sign = np.sign(np.linalg.det(rotation))
        rotation[axis] *= sign[..., None]
        sigma[..., 2] *= sign
    return u, sigma, vt


def closest_rotation(gradients: FloatArray) -> FloatArray:
    """(t, 3, 3): argmin over R in SO(3) of ||F - R||_F, the strain term of eq. (11)."""
    u, _, vt = signed_svd(gradients)
    return u @ vt


def closest_unit_determinant(gradients: FloatArray) -> FloatArray:
    """(t, 3, 3): argmin of ||F - D||_F over matrices with det D = 1, the volume term of eqs (11) and (12).

    D has the singular vectors of F, and its singular values solve `unit_product`.
    """
    u, sigma, vt = signed_svd(gradients)
    return (u * unit_product(sigma)[..., None, :]) @ vt


def unit_product(sigma: FloatArray) -> FloatArray:
    """(t, 3): the d > 0 with d_1 d_2 d_3 = 1 closest to sigma, sigma_1 >= sigma_2 >= |sigma_3|.

    Stationary points obey d_i (d_i - sigma_i) = mu, hence d_i = (sigma_i +- sqrt(sigma_i^2 + 4 mu)) / 2. At a minimum
    at most one curvature is negative, so at most d_3 takes the minus sign, which happens under strong expansion only:
    the closest matrix to 3 I is not I. Then d_3 < sigma_3 / 2, so a point nearer than sigma_3 / 2 needs no search.
    """
    s3 = sigma[..., 2]
    # All signs plus: the product grows with mu.
    low = np.where(s3 > 0, -0.25 * s3**2, 0.0)
    low = np.where(sigma.prod(axis=-1) < 1, 0.0, low)
    high = 1.0 + np.abs(sigma).max(axis=-1)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        small = _plus(sigma, middle).prod(axis=-1) < 1
        low, high = np.where(small, middle, low), np.where(small, high, middle)
    best = _plus(sigma, 0.5 * (low + high))
    distance = ((best - sigma) ** 2).sum(axis=-1)
    distance[np.abs(best.prod(axis=-1) - 1) > 1e-6] = np.inf  # even the least mu leaves the product above one
    for index in zip(*np.nonzero(distance > 0.25 * s3**2), strict=True):
        if sigma[index][2] > 0:
            best[index] = _with_thin_third(sigma[index], best[index], distance[index])
    return best


def _plus(sigma: FloatArray, mu: FloatArray) -> FloatArray:
    root = np.sqrt(np.maximum(sigma**2 + 4 * mu[..., None], 0.0))
    # Written without cancellation for negative sigma.
    return np.where(sigma >= 0, 0.5 * (sigma + root), 2 * mu[..., None] / np.where(sigma >= 0, 1.0, root - sigma))


def _with_thin_third(sigma: FloatArray, best: FloatArray, distance: float) -> FloatArray:
    """The closest of `best` and the points with d_3 < sigma_3 / 2 on the branch with the minus sign."""
    d3 = np.linspace(0.0, 0.5 * sigma[2], 257)[1:]
    low, high = np.r_[0.0, d3[:-1]], d3

    def product(d: FloatArray) -> FloatArray:
        return _plus(sigma[:2], d * (d - sigma[2])).prod(axis=-1) * d

    crossing = (product(low) < 1) & (product(high) >= 1)
    low, high = low[crossing], high[crossing]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        small = product(middle) < 1
        low, high = np.where(small, middle, low), np.where(small, high, middle)
    for third in 0.5 * (low + high):
        candidate = np.append(_plus(sigma[:2], np.asarray(third * (third - sigma[2]))), third)
        squared = ((candidate - sigma) ** 2).sum()
        if squared < distance:
            best, distance = candidate, squared
    return best


def closest_area(gradients: FloatArray, ratios: FloatArray) -> FloatArray:
    """(t, 3, 2): argmin of ||F - D||_F over matrices whose singular values have the product ratio (t,) >= 0.

    The projection of the area terms (A.2) and (A.3): F is the gradient of a triangle in the plane of its rest shape,
    the ratio is that of its wanted area to its rest area. Collapsed triangles have a projection too, though not
    a unique one. Areas have no sign: a lid that closes too far and opens on the other side satisfies them.

    With D of singular values d: d_1 = sigma_1 + nu d_2, d_2 = sigma_2 + nu d_1. As objective and constraint are
    quadratic, the minimum is the one solution with |nu| <= 1.
    """
    u, sigma, vt = np.linalg.svd(gradients, full_matrices=False)
    s1, s2 = sigma[..., 0], sigma[..., 1]
    low, high = -s2 / np.maximum(s1, np.finfo(float).tiny), np.ones_like(s1)
    for _ in range(BISECTIONS):
        nu = 0.5 * (low + high)
        small = (s1 + nu * s2) * (s2 + nu * s1) < ratios * (1 - nu**2) ** 2
        low, high = np.where(small, nu, low), np.where(small, high, nu)
    nu = 0.5 * (low + high)
    scale = np.maximum(1 - nu**2, np.finfo(float).tiny)
    d = np.stack([(s1 + nu * s2) / scale, (s2 + nu * s1) / scale], axis=-1)
    # nu = 1: collapsed to a point, any frame with equal sides is closest; nu = -1: equal sides above 2 sqrt(ratio).
    point = 1 - nu < 1e-12
    d[point] = np.sqrt(ratios)[point][..., None]
    hard = 1 + nu < 1e-12
    root = np.sqrt(np.maximum(s1**2 - 4 * ratios, 0.0))
    d[hard] = np.stack([0.5 * (s1 + root), 0.5 * (s1 - root)], axis=-1)[hard]
    return (u * d[..., None, :]) @ vt
