"""Reference rows: they need the truth or no method at all, are no Retargeters and enter no test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from retarget.types import FloatArray, Pair

Reference = Callable[[Pair, FloatArray, FloatArray], FloatArray]  # pair, target examples, truth -> frames (t, n, 3)


def neutral(pair: Pair, target_examples: FloatArray, truth: FloatArray) -> FloatArray:
    """The target does not move: the size of the motion itself."""
    return np.broadcast_to(pair.target_neutral, truth.shape).copy()


def projection_bound(pair: Pair, target_examples: FloatArray, truth: FloatArray) -> FloatArray:
    """The best that patchwise blendshapes of these examples can do: PLBS fitted to the truth itself."""
    raise NotImplementedError


REFERENCES: dict[str, Reference] = {"neutral": neutral, "projection_bound": projection_bound}
