import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.simulation.tetrahedra import count_inverted, deformation_gradients, gradient_operator, rest_shape
from tests.retarget.simulation.box import box


@pytest.fixture
def shape():
    vertices, tets = box((3, 2, 4), (30.0, 20.0, 25.0))
    inner = (vertices > 0).all(axis=1) & (vertices < vertices.max(axis=0)).all(axis=1)
    return rest_shape(vertices + 2 * np.sin(vertices[:, [1, 2, 0]]) * inner[:, None], tets)


def test_volumes_are_true_volumes_in_cubic_centimetres(shape):
    assert shape.volumes.sum() == pytest.approx(3 * 2 * 2.5)
    assert (shape.volumes > 0).all()


def test_the_gradient_of_an_affine_map_is_its_matrix(shape):
    matrix = np.random.default_rng(0).normal(size=(3, 3))
    moved = shape.vertices @ matrix.T + [1, 2, 3]
    np.testing.assert_allclose(deformation_gradients(shape, moved), np.broadcast_to(matrix, (144, 3, 3)), atol=1e-12)


def test_inverted_and_flat_tets_are_counted(shape):
    moved = shape.vertices + 8 * np.random.default_rng(1).normal(size=shape.vertices.shape)
    inverted = int((np.linalg.det(deformation_gradients(shape, moved)) <= 0).sum())
    assert 10 < inverted == count_inverted(moved, shape.tets)
    assert count_inverted(shape.vertices, shape.tets) == 0
    assert count_inverted(0 * shape.vertices, shape.tets) == len(shape.tets)


def test_the_operator_gives_the_transposed_gradients(shape):
    moved = shape.vertices + np.random.default_rng(1).normal(size=shape.vertices.shape)
    rows = (gradient_operator(shape) @ moved).reshape(-1, 3, 3)
    np.testing.assert_allclose(np.swapaxes(rows, 1, 2), deformation_gradients(shape, moved), atol=1e-12)


@pytest.mark.parametrize("spoil", ["swap", "flatten"])
def test_inverted_and_flat_rest_tets_are_refused(spoil):
    vertices, tets = box((1, 1, 1), (10.0, 10.0, 10.0))
    if spoil == "swap":
        tets[4, :2] = tets[4, 1::-1]
    else:
        tets[4] = [0, 1, 2, 3]  # a face of the box
    with pytest.raises(InvalidInput, match="1 of 6 have zero or negative volume at rest, the first is tet 4"):
        rest_shape(vertices, tets)


@pytest.mark.parametrize("tets", [np.array([[0, 1, 2, 9]]), np.array([[0, 1, 2]]), np.empty((0, 4), int), np.eye(4)])
def test_tets_that_do_not_fit_are_refused(tets):
    with pytest.raises(InvalidInput, match="tets: "):
        rest_shape(np.eye(4, 3), tets)
