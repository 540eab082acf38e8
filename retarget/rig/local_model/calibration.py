"""A strength for each patch from corresponding shapes beyond the examples (Chandran et al. 2022, section 4.6)."""

from __future__ import annotations

import numpy as np

from retarget.rig.local_model.patch_fit import PatchBlendshapes
from retarget.types import FloatArray

STILL = 1e-3  # mm, root of the mean square: patches that move less have nothing to calibrate


def calibrated_strengths(target: PatchBlendshapes, alpha: FloatArray, shapes: FloatArray) -> FloatArray:
    """(P,) factors of the coefficients that bring the target's patches closest to its calibration shapes (t, n, 3) mm.

    alpha (t, P, k) are the coefficients of the source's counterparts. The least-squares factor of a patch is that of
    one line through the origin; a motion of `STILL` holds it to 1 where the examples hardly move. Negative factors,
    which would mirror an expression, become 0. Without calibration shapes every factor is 1.
    """
    strengths = np.ones(alpha.shape[1])
    if not len(shapes):
        return strengths
    wanted = shapes - target.neutral
    for p, (members, deltas) in enumerate(zip(target.layout.members, target.deltas, strict=True)):
        moved = (alpha[:, p] @ deltas.reshape(target.count, -1)).reshape(len(alpha), 3, len(members))
        shown = wanted[:, members].transpose(0, 2, 1)
        held = STILL**2 * len(members) * len(alpha)
        strengths[p] = (np.vdot(moved, shown) + held) / (np.vdot(moved, moved) + held)
    return np.maximum(strengths, 0.0)
