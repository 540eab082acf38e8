"""Deformation transfer as the paper of 2004 writes it: fourth vertices as unknowns, one triangle at a time."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from retarget.types import FloatArray, IntArray


def frame(v1: FloatArray, v2: FloatArray, v3: FloatArray) -> FloatArray:
    normal = np.cross(v2 - v1, v3 - v1)
    v4 = v1 + normal / np.sqrt(np.linalg.norm(normal))
    return np.column_stack([v2 - v1, v3 - v1, v4 - v1])


def system(target: FloatArray, faces: IntArray) -> sp.csr_array:
    """(3f, n + f): the transposed gradient of each triangle from the vertices and one fourth vertex per triangle."""
    rows, columns, values = [], [], []
    for j, (a, b, c) in enumerate(faces):
        inverse = np.linalg.inv(frame(target[a], target[b], target[c]))
        for i in range(3):
            rows += [3 * j + i] * 4
            columns += [b, c, len(target) + j, a]
            values += [*inverse[:, i], -inverse[:, i].sum()]
    return sp.csr_array((values, (rows, columns)), shape=(3 * len(faces), len(target) + len(faces)))


def source_gradients(neutral: FloatArray, expression: FloatArray, faces: IntArray) -> FloatArray:
    """(3f, 3) stacked transposed gradients."""
    return np.vstack([(frame(*expression[t]) @ np.linalg.inv(frame(*neutral[t]))).T for t in faces])


def literal_transfer(
    source: FloatArray, expression: FloatArray, target: FloatArray, faces: IntArray, weights: FloatArray
) -> FloatArray:
    """(n, 3) by dense least squares of smallest norm, so the translation is whatever it happens to be."""
    root = np.repeat(np.sqrt(weights), 3)[:, None]
    matrix = system(target, faces).toarray()
    solution, *_ = np.linalg.lstsq(root * matrix, root * source_gradients(source, expression, faces), rcond=None)
    return solution[: len(target)]
