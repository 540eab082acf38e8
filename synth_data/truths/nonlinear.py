"""The generator of personal expressions evaluated on the weights themselves: muscles, sliding, lids, a turning jaw."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

from retarget.types import FloatArray
from synth_data.cache import ArrayCache
from synth_data.dataset import Progress
from synth_data.personal.face import PersonalFace, personal_face
from synth_data.truth import Casting, GenericRig, Person, Truth


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
        return lambda person: Generator(generic, person)


@dataclass(frozen=True)
class Generator:
    """The face of a person, made when it is first asked to move; its factors stay behind when it is pickled."""

    generic: GenericRig
    person: Person

    def __call__(self, weights: FloatArray) -> FloatArray:
        """(t, n, 3) mm for weights (t, 51) of `SKIN_NAMES`."""
        return self._face(weights)

    @cached_property
    def _face(self) -> PersonalFace:
        return personal_face(self.person.neutral, self.generic.faces, self.generic.regions, self.person.traits)

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}


TRUTH = Nonlinear()
