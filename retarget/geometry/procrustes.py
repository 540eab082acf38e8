"""Rigid and similarity alignment of corresponding points (Kabsch 1976; Umeyama 1991)."""

from __future__ import annotations

import numpy as np

from retarget.check import InvalidInput, check_vertices
from retarget.types import FloatArray


def rigid_align(moving: FloatArray, fixed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rotation R (3, 3) and translation t (3,) in mm that minimise || moving @ R.T + t - fixed ||^2.

    moving and fixed are (m, 3) corresponding points in mm. R is a proper rotation, never a reflection, and there
    is no scale: heads keep their true size. Raises InvalidInput if the points leave the rotation undetermined.
    """
    moving = check_vertices("moving", moving)
    fixed = check_vertices("fixed", fixed)
    if len(moving) != len(fixed) or len(moving) < 3:
        raise InvalidInput(
            f"rigid_align: expected at least 3 points and as many moving as fixed, got {len(moving)} and {len(fixed)}; "
            "a region may be empty or belong to another topology."
        )
    moving_mean, fixed_mean = moving.mean(axis=0), fixed.mean(axis=0)
    u, sigma, vt = np.linalg.svd((fixed - fixed_mean).T @ (moving - moving_mean))
    sign = np.sign(np.linalg.det(u @ vt))
    # Without a reflection the rotation is unique if the two smallest singular values do not cancel.
    if sigma[1] + sign * sigma[2] <= 1e-12 * sigma[0]:
        raise InvalidInput(
            f"rigid_align: the {len(moving)} points do not determine a rotation (singular values {sigma}). "
            "Expected at least 3 points that do not lie on one line."
        )
    rotation = u @ np.diag([1.0, 1.0, sign]) @ vt
    return rotation, fixed_mean - rotation @ moving_mean


def similarity_align(moving: FloatArray, fixed: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Scale s, rotation R (3, 3) and translation t (3,) in mm that minimise || s * moving @ R.T + t - fixed ||^2.

    Umeyama (1991), eqs (40) to (42): s = tr(D Sigma) / variance of `moving`. Raises InvalidInput as `rigid_align`.
    """
    rotation, _ = rigid_align(moving, fixed)
    moving_mean, fixed_mean = moving.mean(axis=0), fixed.mean(axis=0)
    centred = moving - moving_mean
    # With the best rotation, tr(D Sigma) is the inner product of the rotated and the fixed points.
    scale = float(np.vdot(centred @ rotation.T, fixed - fixed_mean) / np.vdot(centred, centred))
    return scale, rotation, fixed_mean - scale * rotation @ moving_mean
