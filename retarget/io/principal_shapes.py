"""An animation as few shapes and their weights over time, for files that hold morph targets."""

from __future__ import annotations

import numpy as np

from retarget.io.morph_mesh import MorphMesh
from retarget.types import FloatArray


def principal_shapes(
    name: str, neutral: FloatArray, frames: FloatArray, times: FloatArray, tolerance: float = 0.05
) -> MorphMesh:
    """Frames (t, n, 3) mm at times (t,) s as principal components of their displacements from the neutral (n, 3) mm.

    As many as keep every vertex of every frame within `tolerance` mm. Their weights lie within [-1, 1].
    """
    moved = (frames - neutral).reshape(len(frames), -1)
    values, vectors = np.linalg.eigh(moved @ moved.T)  # (t, t): far smaller than what it comes from
    vectors = vectors[:, ::-1][:, : int((values > 1e-12 * max(values.max(), 1e-12)).sum())]
    shapes, missed, count = vectors.T @ moved, moved.copy(), 0  # shapes: (r, 3 n)
    while count < len(shapes) and _longest(missed) > tolerance:
        missed -= np.outer(vectors[:, count], shapes[count])
        count += 1
    weights, shapes = vectors[:, :count], shapes[:count]
    largest = np.abs(weights).max(axis=0, initial=0.0)
    largest[largest == 0] = 1.0
    targets = neutral + (shapes * largest[:, None]).reshape(count, *neutral.shape)
    return MorphMesh(name, neutral, targets, tuple(f"shape_{i:02d}" for i in range(count)), times, weights / largest)


def _longest(vectors: FloatArray) -> float:
    """Of vectors (t, 3 n)."""
    each = vectors.reshape(len(vectors), -1, 3)
    return float(np.sqrt(np.einsum("tni,tni->tn", each, each).max()))
