import numpy as np
import pytest

from retarget.geometry.triangles import areas, deformation_gradients, fourth_edges, frames, gradient_operators
from tests.synthetic import ball, head


def test_fourth_edge_by_hand():
    # legs 4 and 9 along x and y: n = (0, 0, 36), so v4 - v1 = (0, 0, 6)
    vertices = np.array([[1.0, 2, 3], [5, 2, 3], [1, 11, 3]])
    np.testing.assert_allclose(fourth_edges(vertices, np.array([[0, 1, 2]])), [[0, 0, 6]])
    np.testing.assert_allclose(frames(vertices, np.array([[0, 1, 2]]))[0], np.diag([4.0, 9, 6]))
    np.testing.assert_allclose(areas(vertices, np.array([[0, 1, 2]])), [18])


def test_a_collapsed_triangle_has_the_limit_of_its_fourth_edge():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    np.testing.assert_array_equal(fourth_edges(vertices, np.array([[0, 1, 2]])), np.zeros((1, 3)))


def test_fourth_edge_grows_like_a_length():
    vertices, (_, faces) = head(1), ball()
    np.testing.assert_allclose(fourth_edges(3 * vertices, faces), 3 * fourth_edges(vertices, faces), atol=1e-11)


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_gradient_of_a_similarity_is_its_matrix(scale):
    vertices, (_, faces) = head(1), ball()
    rotation, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    gradients = deformation_gradients(vertices, scale * vertices @ rotation.T + 7, faces)
    np.testing.assert_allclose(gradients, np.broadcast_to(scale * rotation, gradients.shape), atol=1e-9)


def test_operators_and_matrices_give_the_same_gradients():
    rest, deformed, (_, faces) = head(1), head(2), ball()
    gradient, normal = gradient_operators(rest, faces)
    stacked = (gradient @ deformed + normal @ fourth_edges(deformed, faces)).reshape(-1, 3, 3)
    np.testing.assert_allclose(stacked.transpose(0, 2, 1), deformation_gradients(rest, deformed, faces), atol=1e-12)


def test_area_weighted_poisson_matrix_is_the_cotangent_laplacian():
    vertices, (_, faces) = head(1), ball()
    n = len(vertices)
    gradient, _ = gradient_operators(vertices, faces)
    laplacian = (gradient.T * np.repeat(areas(vertices, faces), 3)) @ gradient
    cotangents = np.zeros((n, n))
    for a, b, c in faces:
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):  # the edge ij lies opposite to the corner k
            u, v = vertices[i] - vertices[k], vertices[j] - vertices[k]
            cotangents[i, j] += 0.5 * u @ v / np.linalg.norm(np.cross(u, v))
    cotangents += cotangents.T
    np.testing.assert_allclose(laplacian.toarray(), np.diag(cotangents.sum(axis=1)) - cotangents, atol=1e-12)
