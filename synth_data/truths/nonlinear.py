"""The generator of personal expressions evaluated on the weights themselves: muscles, sliding, lids, a turning jaw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from synth_data.cache import ArrayCache
from synth_data.dataset import Progress
from synth_data.personal.face import personal_face
from synth_data.truth import Casting, GenericRig, Truth


@dataclass(frozen=True)
class Nonlinear(Truth):
    """`synth_data.personal.face.PersonalFace`; docs/personal_expressions.md says how it moves."""

    favours: ClassVar[str] = (
        "The ground truth is a synthetic generator whose mechanism no compared method has: a turning jaw, skin that "
        "slides over the skull, contraction along muscle lines, lids that turn, folds. Units are not additive, so no "
        "linear method becomes exact. The jaw's arcs and the volume kept by compressed tissue are what a volumetric "
        "method resembles most. It was fitted to no scans and shows nothing about real people."
    )
    rehearsed: ClassVar[bool] = True

    def prepare(self, generic: GenericRig, cache: ArrayCache, progress: Progress) -> Casting:
        return lambda person: personal_face(person.neutral, generic.faces, generic.regions, person.traits)


TRUTH = Nonlinear()
