"""Facial characteristics fc (eqs (15) to (17)): what of an expression the target is held to, whatever its anatomy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from retarget.check import InvalidInput, check_vertices
from retarget.geometry.procrustes import similarity_align
from retarget.geometry.triangles import areas
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.simulation.area_terms import DEGENERATE
from retarget.types import FloatArray, IntArray, Pair, Regions

EYE_OPENINGS = ("eye_opening_left", "eye_opening_right")
EYE_SOCKETS = ("eye_socket_left", "eye_socket_right")


def lip_contour(regions: Regions) -> IntArray:
    """(k,) skin vertices of the loop LC of eqs (16) and (17), in its order; none where the topology lacks it."""
    contour: IntArray = np.asarray(regions.loops.get("lip_contour", ()), dtype=np.int64)
    return contour


def eye_triangles(regions: Regions, names: tuple[str, ...]) -> IntArray:
    """(f, 3) the patches of EYE_OPENINGS or EYE_SOCKETS, one after the other, without those that are not there."""
    return np.concatenate([regions.patches.get(name, np.empty((0, 3), np.int64)) for name in names])


@dataclass(frozen=True)
class Characteristics:
    """F_i of eq. (9); None leaves a term out.

    Areas are relative to the target's neutral triangle, A(S_i, f) / A(S, f), so F_eo = eye_opening * A(T, f).
    """

    eye_opening: FloatArray | None = None  # (f,) of the patches EYE_OPENINGS, one after the other
    eye_socket: FloatArray | None = None  # (f,) of the patches EYE_SOCKETS
    lip_contour: FloatArray | None = None  # (k, 3) mm, wanted positions of the loop `lip_contour`: F_lc


class LipForm(StrEnum):
    """How the lip contour carries over."""

    PRINTED = "printed"  # eq. (16): the source's contour, moved by a similarity; the neutral does not stay
    RELATIVE = "relative"  # differs from the paper: plus what eq. (16) misses at the neutral, so the neutral stays


class FacialCharacteristics:
    """fc of eq. (15) for a pair of neutrals, with deformation transfer prepared."""

    def __init__(
        self, pair: Pair, lips: LipForm | str = LipForm.RELATIVE, weighting: Weighting | str = Weighting.UNIFORM
    ) -> None:
        """Terms whose loop or patches the topology lacks are left out. Raises InvalidInput as deformation transfer."""
        self.pair, self.lips = pair, LipForm(lips)
        self._contour = lip_contour(pair.regions)
        self._transfer = DeformationTransfer.of(pair, weighting).at(self._contour) if len(self._contour) else None
        self._missed = np.zeros((len(self._contour), 3))
        if len(self._contour) and self.lips is LipForm.RELATIVE:
            source, target = (neutral[self._contour] for neutral in (pair.source_neutral, pair.target_neutral))
            self._missed = target - _similar(source, target)

    def __call__(self, expression: FloatArray) -> Characteristics:
        """F_i for a source expression S_i (n, 3) mm."""
        skin = check_vertices("expression", expression, len(self.pair.source_neutral))
        return Characteristics(
            self._ratios(skin, EYE_OPENINGS), self._ratios(skin, EYE_SOCKETS), self._lip_contour(skin)
        )

    def _ratios(self, skin: FloatArray, names: tuple[str, ...]) -> FloatArray | None:
        """fc_eo and fc_es; a triangle without an area in S takes the ratio of its whole patch."""
        patches = self.pair.regions.patches
        if any(name not in patches for name in names):
            return None
        ratios = []
        for name in names:
            before, now = (areas(v, patches[name]) for v in (self.pair.source_neutral, skin))
            usable = before > DEGENERATE * before.max(initial=0.0)
            if not usable.any():
                raise InvalidInput(f"{name}: expected triangles with an area in the source's neutral, got none.")
            whole = now[usable].sum() / before[usable].sum()
            ratios.append(np.where(usable, now / np.where(usable, before, 1.0), whole))
        return np.concatenate(ratios)

    def _lip_contour(self, skin: FloatArray) -> FloatArray | None:
        """fc_lc of eqs (16) and (17)."""
        if self._transfer is None:
            return None
        contour: FloatArray = _similar(skin[self._contour], self._transfer(skin)) + self._missed
        return contour


def _similar(moving: FloatArray, fixed: FloatArray) -> FloatArray:
    """moving (k, 3), brought to fixed (k, 3) by the best similarity."""
    scale, rotation, translation = similarity_align(moving, fixed)  # eq. (17)
    aligned: FloatArray = scale * moving @ rotation.T + translation  # eq. (16)
    return aligned
