import numpy as np

from retarget.geometry.graph import components, vertex_adjacency


def test_two_triangles_with_a_shared_edge_and_a_lonely_vertex():
    adjacency = vertex_adjacency(np.array([[0, 1, 4], [4, 1, 2]]), 5)
    expected = np.zeros((5, 5))
    for i, j in [(0, 1), (1, 4), (0, 4), (1, 2), (2, 4)]:
        expected[i, j] = expected[j, i] = 1
    np.testing.assert_array_equal(adjacency.toarray(), expected)
    assert [piece.tolist() for piece in components(adjacency)] == [[0, 1, 2, 4], [3]]
