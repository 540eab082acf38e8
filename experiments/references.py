"""Reference rows: they need the truth or no method at all, are no Retargeters and enter no test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import Ridge, projection
from retarget.types import FloatArray, Pair

PreparedReference = Callable[[FloatArray, FloatArray], FloatArray]  # target examples, truth -> frames (t, n, 3)
Reference = Callable[[Pair], PreparedReference]

PATCHES = 80  # the paper's number (Fig. 1), and the default of the method `plbs`
NEARLY_NO_RIDGE = Ridge(1e-9)  # mm^2 per vertex: only keeps still patches solvable


def neutral(pair: Pair) -> PreparedReference:
    """The target does not move: the size of the motion itself."""
    return lambda examples, truth: np.broadcast_to(pair.target_neutral, truth.shape).copy()


def projection_bound(pair: Pair) -> PreparedReference:
    """Patchwise blendshapes of the target's examples fitted to the truth itself: the best that PLBS could do."""
    patches = contiguous_patches(pair.faces, len(pair.target_neutral), PATCHES)
    return lambda examples, truth: projection(pair.target_neutral, examples, truth, patches, NEARLY_NO_RIDGE)


def truth(pair: Pair) -> PreparedReference:
    """The truth itself: what it scores in measures that do not compare with it, such as crossings."""
    return lambda examples, truth: truth.copy()


REFERENCES: dict[str, Reference] = {"neutral": neutral, "projection_bound": projection_bound, "truth": truth}
