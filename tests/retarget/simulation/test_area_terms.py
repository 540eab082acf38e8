import numpy as np

from retarget.geometry.triangles import areas
from retarget.simulation.area_terms import area_terms, project
from retarget.simulation.projections import closest_area


def test_the_kernel_agrees_with_the_reference():
    rng = np.random.default_rng(0)
    f = rng.normal(size=(300, 3, 2)) * np.geomspace(1e-3, 10, 300)[:, None, None]
    f[0], f[1], f[2], f[3] = 0, [[1, 1], [2, 2], [0, 0]], [[1, 0], [0, 1], [0, 0]], [[3, 0], [0, 3], [0, 0]]
    for ratio in (0.0, 1e-3, 0.3, 1.0, 2.5):
        ratios = np.full(len(f), ratio)
        expected = closest_area(f, ratios)
        found = project(np.swapaxes(f, 1, 2).reshape(-1, 3).copy(), ratios)
        found = np.swapaxes(found.reshape(-1, 2, 3), 1, 2)
        distance = [((f - d) ** 2).sum(axis=(1, 2)) for d in (found, expected)]
        np.testing.assert_allclose(*distance, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(np.linalg.svd(found, compute_uv=False).prod(axis=1), ratio, atol=1e-7)
        sigma = np.linalg.svd(f, compute_uv=False)
        unique = sigma[:, 0] - sigma[:, 1] > 1e-2 * sigma[:, 0]
        unique &= sigma[:, 1] > 1e-6
        np.testing.assert_allclose(found[unique], expected[unique], atol=1e-6)


def test_the_gradient_of_a_triangle_has_its_area_ratio_as_product():
    rng = np.random.default_rng(1)
    rest, moved = rng.normal(size=(2, 9, 3))
    triangles = np.arange(9).reshape(3, 3)
    terms = area_terms(rest, triangles)
    gradients = np.swapaxes((terms.operator @ moved).reshape(-1, 2, 3), 1, 2)
    product = np.linalg.svd(gradients, compute_uv=False).prod(axis=1)
    np.testing.assert_allclose(product, areas(moved, triangles) / areas(rest, triangles))
    np.testing.assert_allclose(terms.weights, areas(rest, triangles) / 100)


def test_triangles_without_an_area_at_rest_get_no_term():
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]])
    terms = area_terms(rest, np.array([[0, 1, 2], [0, 1, 3], [1, 1, 3]]))
    np.testing.assert_array_equal(terms.kept, [1])
    assert np.isfinite(terms.operator.data).all()
