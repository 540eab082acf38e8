import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.geometry.procrustes import rigid_align


@pytest.fixture
def points():
    return np.random.default_rng(0).normal(0, 50, (40, 3))


def test_recovers_a_known_motion(points):
    rotation, translation = Rotation.from_rotvec([0.4, -1.2, 2.0]).as_matrix(), np.array([3.0, -40.0, 7.0])
    r, t = rigid_align(points, points @ rotation.T + translation)
    np.testing.assert_allclose(r, rotation, atol=1e-12)
    np.testing.assert_allclose(t, translation, atol=1e-11)


def test_is_the_best_rigid_motion_for_noisy_points(points):
    fixed = points[:, [1, 2, 0]] * 1.3 + np.random.default_rng(1).normal(0, 5, points.shape)
    r, t = rigid_align(points, fixed)

    def error(rotation, translation):
        return np.sum((points @ rotation.T + translation - fixed) ** 2)

    best = error(r, t)
    for rotvec in 1e-4 * np.vstack([np.eye(3), -np.eye(3)]):
        assert error(Rotation.from_rotvec(rotvec).as_matrix() @ r, t) > best
        assert error(r, t + rotvec) > best
    # second implementation of the rotation
    other, _ = Rotation.align_vectors(fixed - fixed.mean(axis=0), points - points.mean(axis=0))
    np.testing.assert_allclose(r, other.as_matrix(), atol=1e-9)


def test_never_reflects_nor_scales(points):
    r, _ = rigid_align(points, 2 * points * [-1, 1, 1])
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1)


def test_coplanar_points_are_enough(points):
    flat = points * [1, 1, 0]
    rotation = Rotation.from_rotvec([1.0, 0.5, 0.2]).as_matrix()
    r, _ = rigid_align(flat, flat @ rotation.T)
    np.testing.assert_allclose(r, rotation, atol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_refuses_too_few_points(points, count):
    with pytest.raises(InvalidInput, match="at least 3 points"):
        rigid_align(points[:count], points[:count])


def test_refuses_collinear_points(points):
    line = np.outer(np.arange(9.0), [1, 2, 3])
    with pytest.raises(InvalidInput, match="one line"):
        rigid_align(line, line)
    with pytest.raises(InvalidInput, match="as many moving as fixed"):
        rigid_align(points[:9], points[:40])
