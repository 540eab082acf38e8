"""Seeded identities: Gaussian coefficients of ICT-FaceKit's identity modes, heads at their true size."""

from __future__ import annotations

import numpy as np

from retarget.anatomy.crossings import self_intersections
from retarget.anatomy.separate import lip_parting
from retarget.geometry.procrustes import rigid_align
from retarget.types import FloatArray, Regions
from synth_data.ict_facekit.model import FaceModel
from synth_data.personal.traits import draw_traits
from synth_data.truth import Person

LARGEST = 2.0  # standard deviations of a mode; a coefficient beyond is drawn again
YOUNGEST, OLDEST = 20.0, 65.0  # years: the model does not tell ages, and folds need one
PARTING = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0)  # mm that each lip may move: the model's own lips touch and cross
STILL = 1e-3  # of an upper lip's motion, below which skin is away from the lips

_MODES, _AGE = 8, 9  # streams of the seed


class IdentitySampler:
    """Draws people from one model; the same seed gives the same person, whatever was drawn before."""

    def __init__(self, model: FaceModel, regions: Regions):
        self._model = model
        self._cranium = regions.vertices["cranium"]
        self._up = lip_parting(model.neutral, model.faces, regions)
        self.neutral = self._parted(model.neutral)  # (n, 3) mm

    def __call__(self, seed: int) -> Person:
        """A head (n, 3) mm, aligned to the generic one on the cranium by rotation and translation, never scaled."""
        vertices = self._model.neutral.copy()
        for number, mode in self._model.modes.items():
            vertices += coefficient(seed, number) * mode
        rotation, translation = rigid_align(vertices[self._cranium], self._model.neutral[self._cranium])
        years = np.random.default_rng([seed, _AGE]).uniform(YOUNGEST, OLDEST)
        return Person(self._parted(vertices @ rotation.T + translation), draw_traits(seed, float(years)))

    def _parted(self, vertices: FloatArray) -> FloatArray:
        """With lips apart by the least of `PARTING` that leaves none crossing, or else the fewest."""
        tried = []
        for each in PARTING:
            moved = vertices + each * np.outer(self._up, [0.0, 1.0, 0.0])
            crossing = self._model.faces[self_intersections(moved, self._model.faces)]
            at_lips = int((np.abs(self._up[crossing]) > STILL).any(axis=(1, 2)).sum())
            if at_lips == 0:
                return moved
            tried.append((at_lips, each, moved))
        return min(tried, key=lambda attempt: attempt[:2])[2]


def coefficient(seed: int, mode: int) -> float:
    """Of one mode, a Gaussian cut at `LARGEST`. It depends on no other mode: a larger clone refines the same person."""
    rng = np.random.default_rng([seed, _MODES, mode])
    while abs(drawn := float(rng.standard_normal())) > LARGEST:
        pass
    return drawn
