"""How far the examples explain an expression, and an anacon that stands back where they do.

# differs from the paper: anacon (eq. 19) holds the face to fc(S_i, S, T) and to what tets can follow, whatever the
examples know. Both cost accuracy where the examples rebuild the source's expression: there the blended expression is
that of the target itself. So with the relative miss of each patch p,

    m = min(1, ||S_i^P - S_i||_p / ||S_i - S||_p),    1 without examples, 0 where they explain all of the motion,

spread a little over the mesh, anacon's result T_i is

    held to        draft + m^q (fc(S_i, S, T) - draft)      where eq. (19) holds it to fc(S_i, S, T), and
    completed by   (1 - m)^c (draft - P x_inv - r)          what the tissue of invSim could not follow of the draft.

Where nothing is explained this is eq. (19). `draft` is T_i^P plus the missing blendshape, P x_inv + r the skin that
invSim forms. What tissue does not follow are the jumps between patches, which appear where patches miss, and detail
finer than tets.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from retarget.check import InvalidInput
from retarget.geometry.laplacian import heat
from retarget.rig.blendshapes import Patches
from retarget.simulation.characteristics import (
    EYE_OPENINGS,
    EYE_SOCKETS,
    Characteristics,
    FacialCharacteristics,
    eye_triangles,
    lip_contour,
)
from retarget.types import FloatArray, IntArray, Pair

NOISE = 0.05  # mm, rms: motion below it needs no explanation
SPREAD = 6.0  # mm: standard deviation of the heat that carries the miss over the borders of patches


@dataclass(frozen=True)
class EvidenceSettings:
    """How fast anacon stands back. Raises InvalidInput for an exponent that is not positive."""

    sharpness: float = 1.0  # q: larger, characteristics stand back sooner
    caution: float = 4.0  # c: larger, jumps between patches are taken back less readily

    def __post_init__(self) -> None:
        for name in ("sharpness", "caution"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise InvalidInput(f"{name}: expected a positive number, got {value}.")


class Evidence:
    """The relative miss of patches, and what it leaves of characteristics, for a pair."""

    def __init__(self, pair: Pair, patches: Patches, settings: EvidenceSettings) -> None:
        """Raises InvalidInput as `FacialCharacteristics`."""
        self.pair, self.patches, self.settings = pair, patches, settings
        regions = pair.regions
        itself = Pair(pair.faces, pair.target_neutral, pair.target_neutral, replace(regions, loops={}))
        self._areas = FacialCharacteristics(itself)
        self._contour = lip_contour(regions)
        self._triangles: dict[tuple[str, ...], IntArray] = {
            names: eye_triangles(regions, names) for names in (EYE_OPENINGS, EYE_SOCKETS)
        }
        self._spread = heat(pair.source_neutral, pair.faces, SPREAD)

    def miss(self, expression: FloatArray, rebuilt: FloatArray) -> FloatArray:
        """m (n,) for S_i (n, 3) mm and S_i^P (n, 3) mm."""
        missed = ((rebuilt - expression) ** 2).sum(axis=1)
        motion = ((expression - self.pair.source_neutral) ** 2).sum(axis=1) + NOISE**2
        share = np.empty(len(expression))
        for patch in self.patches:
            share[patch] = min(1.0, np.sqrt(missed[patch].sum() / motion[patch].sum()))
        return self._spread(share)

    def detail(self, unfollowed: FloatArray, miss: FloatArray) -> FloatArray:
        """(n, 3) mm: what the result is completed by, of what tissue could not follow of the draft (n, 3) mm."""
        kept: FloatArray = ((1 - miss) ** self.settings.caution)[:, None] * unfollowed
        return kept

    def held(self, wanted: Characteristics, draft: FloatArray, miss: FloatArray) -> Characteristics:
        """What the skin is held to, for fc(S_i, S, T) as `wanted` and the draft (n, 3) mm."""
        shown, left_open = self._areas(draft), miss**self.settings.sharpness

        def eyes(names: tuple[str, ...], there: FloatArray | None, here: FloatArray | None) -> FloatArray | None:
            if there is None or here is None:
                return None
            blended: FloatArray = here + left_open[self._triangles[names]].mean(axis=1) * (there - here)
            return blended

        lips = wanted.lip_contour
        if lips is not None:
            contour = self._contour
            lips = draft[contour] + left_open[contour, None] * (lips - draft[contour])
        return Characteristics(
            eyes(EYE_OPENINGS, wanted.eye_opening, shown.eye_opening),
            eyes(EYE_SOCKETS, wanted.eye_socket, shown.eye_socket),
            lips,
        )
