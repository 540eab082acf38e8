"""Characteristics that stand back where the examples explain an expression.

# differs from the paper: eq. (19) holds anacon to fc(S_i, S, T) whatever the examples know. fc carries lips and lids
over by geometry alone; where the examples rebuild the source's lips, the blended lips T_i^P are those of the target
itself and better. So each characteristic is held to

    draft + u (fc(S_i, S, T) - draft),      u = min(1, ||S_i - S_i^P||^2 / ||S_i - S||^2)  on its vertices,

where draft is what T_i^P plus the missing blendshape shows, and u is the share of the motion that was not rebuilt: 1
without examples, which is eq. (19), and 0 where they explain all of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from retarget.simulation.characteristics import (
    EYE_OPENINGS,
    EYE_SOCKETS,
    Characteristics,
    FacialCharacteristics,
)
from retarget.types import FloatArray, IntArray, Pair

NOISE = 0.05  # mm, rms: motion below it explains nothing and needs no explanation


class Evidence:
    """Characteristics for a pair, weighed against what a draft of the target's expression shows."""

    def __init__(self, pair: Pair, characteristics: FacialCharacteristics) -> None:
        """characteristics: fc of the pair. Raises InvalidInput as `FacialCharacteristics`."""
        regions = pair.regions
        self.pair, self._fc = pair, characteristics
        self._own = FacialCharacteristics(
            Pair(pair.faces, pair.target_neutral, pair.target_neutral, replace(regions, loops={}))
        )
        self._contour: IntArray = np.asarray(regions.loops.get("lip_contour", ()), dtype=np.int64)
        self._sides: dict[tuple[str, ...], list[IntArray]] = {
            names: [regions.patches[name] for name in names if name in regions.patches]
            for names in (EYE_OPENINGS, EYE_SOCKETS)
        }

    def __call__(self, expression: FloatArray, rebuilt: FloatArray, draft: FloatArray) -> Characteristics:
        """For S_i (n, 3) mm, S_i^P (n, 3) mm and the target's draft (n, 3) mm."""
        wanted, shown = self._fc(expression), self._own(draft)

        def openness(vertices: IntArray) -> float:
            return self._unexplained(expression, rebuilt, vertices)

        def eyes(names: tuple[str, ...], there: FloatArray | None, here: FloatArray | None) -> FloatArray | None:
            if there is None or here is None:
                return None
            shares = [np.full(len(patch), openness(np.unique(patch))) for patch in self._sides[names]]
            return here + np.concatenate(shares) * (there - here)

        lips = wanted.lip_contour
        if lips is not None:
            lips = draft[self._contour] + openness(self._contour) * (lips - draft[self._contour])
        return Characteristics(
            eyes(EYE_OPENINGS, wanted.eye_opening, shown.eye_opening),
            eyes(EYE_SOCKETS, wanted.eye_socket, shown.eye_socket),
            lips,
        )

    def _unexplained(self, expression: FloatArray, rebuilt: FloatArray, vertices: IntArray) -> float:
        """u of the vertices (m,): the share of their squared motion that was not rebuilt, from 0 to 1."""
        missed = expression[vertices] - rebuilt[vertices]
        motion = expression[vertices] - self.pair.source_neutral[vertices]
        return float(min(1.0, (missed**2).sum() / ((motion**2).sum() + len(vertices) * NOISE**2)))
