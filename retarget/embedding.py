"""Embedding of target examples in the source's domain, where no correspondence is known (AnaConDaR section 3.5).

The target's examples are carried over by adt, and what comes out is rebuilt from the source's own animation:

    S_j^adt = adt(T_j, T, S)                                                                        eq. (20)
    S_j     = S + sum_i w_ij (S_i - S),  w the best fit of all source expressions S_i to S_j^adt     eq. (21)

so the result holds no detail of the target's. The fit is the one of eqs (1) to (3), with the whole animation as
blendshapes.
"""

from __future__ import annotations

from collections.abc import Callable

from retarget.check import check_frames
from retarget.rig.blendshapes import Blendshapes, Patches, Ridge, RidgeFit, whole_mesh
from retarget.types import FloatArray

RIDGE = Ridge(1e-3)  # mm^2 per vertex

Transfer = Callable[[FloatArray], FloatArray]  # target expressions (k, n, 3) mm -> the source's (k, n, 3) mm


class AnimationSpan:
    """What an animation (N, n, 3) mm of a neutral (n, 3) mm can show, by patch; factorised once."""

    def __init__(self, neutral: FloatArray, animation: FloatArray, patches: Patches, ridge: Ridge) -> None:
        """Raises InvalidInput for arrays that do not fit together."""
        self._blendshapes = Blendshapes(neutral, animation, patches)
        self._fit = RidgeFit(self._blendshapes, ridge)

    def __call__(self, frames: FloatArray) -> FloatArray:
        """Eq. (21): frames (k, n, 3) mm, each as near as the span comes to it."""
        frames = check_frames("frames", frames, len(self._blendshapes.neutral))
        return self._blendshapes.blend(self._fit.weights(frames))


def embed_examples(
    target_examples: FloatArray,
    animation: FloatArray,
    source_neutral: FloatArray,
    transfer: Transfer,
    patches: Patches | None = None,
    ridge: Ridge = RIDGE,
) -> FloatArray:
    """The source's counterparts (k, n, 3) mm of target examples (k, n, 3) mm; k may be 0.

    animation (N, n, 3) mm is the source's; transfer is adt from the target to the source. Without patches it is one
    fit of the whole mesh, which came nearer to the source's own expressions than one for each patch.
    Raises InvalidInput for arrays that do not fit together.
    """
    count = len(source_neutral)
    examples = check_frames("target_examples", target_examples, count)
    carried = transfer(examples) if len(examples) else examples  # eq. (20)
    return AnimationSpan(source_neutral, animation, patches or whole_mesh(count), ridge)(carried)  # eq. (21)
