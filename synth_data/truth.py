"""Kinds of ground truth behind one interface: how a person performs weights of ARKit's face units.

A dataset knows its people at rest (`Person`) and what they share (`GenericRig`); a kind of truth makes each of them a
`Performer`. Every kind is one file of the package `synth_data.truths`, named as `dataset.truth` names it;
docs/truths.md compares them.
"""

from __future__ import annotations

import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import ClassVar

import numpy as np

import synth_data.truths
from retarget.check import InvalidInput, check_faces, check_frames, check_vertices
from retarget.io.regions import encode
from retarget.suggest import choose
from retarget.types import FloatArray, IntArray, Regions
from synth_data.arkit import MIRRORED, SKIN_NAMES
from synth_data.cache import ArrayCache, fingerprint
from synth_data.code import code_digest
from synth_data.dataset import Progress
from synth_data.personal.traits import Traits

Performer = Callable[[FloatArray], FloatArray]  # (t, 51) weights of `SKIN_NAMES` to (t, n, 3) mm on the base topology

FLIP = np.array([-1.0, 1.0, 1.0])  # a mirror at x = 0
OPPOSITE = np.array([SKIN_NAMES.index(MIRRORED[name]) for name in SKIN_NAMES])  # unit i seen in a mirror


@dataclass(frozen=True)
class Person:
    """Someone before any expression: a face at rest and a way of moving, which holds the seed and the age."""

    neutral: FloatArray  # (n, 3) mm
    traits: Traits

    def mirrored(self, mirror: IntArray) -> Person:
        """The same person in a mirror at x = 0; mirror (n,) is that of the topology's regions."""
        return Person(self.neutral[mirror] * FLIP, self.traits.mirrored())


@dataclass(frozen=True)
class GenericRig:
    """What all people of one topology share. Raises InvalidInput for arrays that do not fit together."""

    neutral: FloatArray  # (n, 3) mm: an average face
    faces: IntArray  # (f, 3)
    deltas: FloatArray  # (51, n, 3) mm: displacements of `SKIN_NAMES` at full strength
    regions: Regions  # with the names that docs/regions.md lists

    def __post_init__(self) -> None:
        n = len(check_vertices("generic neutral", self.neutral))
        check_faces("faces", self.faces, n)
        if len(check_frames("generic deltas", self.deltas, n)) != len(SKIN_NAMES):
            raise InvalidInput(
                f"generic deltas: expected one for each of the {len(SKIN_NAMES)} units that move skin, got "
                f"{len(self.deltas)}."
            )

    def symmetrised(self) -> GenericRig:
        """With the mean of each unit and its mirror image's mirror image. Raises InvalidInput without a mirror."""
        if self.regions.mirror is None:
            raise InvalidInput("regions: expected `mirror`, the mirror image of each vertex, got none.")
        mirrored = self.deltas[OPPOSITE][:, self.regions.mirror] * FLIP
        return replace(self, deltas=0.5 * (self.deltas + mirrored))


Casting = Callable[[Person], Performer]


class Truth(ABC):
    """A kind of ground truth: a frozen dataclass of its settings, and the constant `TRUTH` of its file."""

    favours: ClassVar[str]  # what it resembles and cannot show, for the report
    rehearsed: ClassVar[bool] = False  # whether all frames are performed once, at load, and then read from the cache

    @abstractmethod
    def prepare(self, generic: GenericRig, cache: ArrayCache, progress: Progress) -> Casting:
        """Everything that is computed once for a topology; what it returns makes the performer of each person.

        The same person and weights give the same bits, and zero weights give the neutral, bit for bit.
        """


@dataclass(frozen=True)
class Blendshapes:
    """neutral + sum_j w_j delta_j."""

    neutral: FloatArray  # (n, 3) mm
    deltas: FloatArray  # (51, n, 3) mm

    def __call__(self, weights: FloatArray) -> FloatArray:
        weights = np.atleast_2d(weights)
        frames = np.empty((len(weights), *self.neutral.shape))
        for frame, strengths in zip(frames, weights, strict=True):  # one by one: the same bits alone and among others
            frame[:] = self.neutral + np.tensordot(strengths, self.deltas, axes=1)
        return frames


@dataclass(frozen=True)
class Rehearsed:
    """A performer whose longer performances are kept in a cache."""

    performer: Performer
    key: str
    cache: ArrayCache
    shortest: ClassVar[int] = 8  # frames that are worth a file

    def __call__(self, weights: FloatArray) -> FloatArray:
        weights = np.atleast_2d(weights)
        if len(weights) < self.shortest:
            return self.performer(weights)
        return self.cache(fingerprint([self.key, weights]), lambda: self.performer(weights))


def truth_kinds() -> tuple[str, ...]:
    """The names that `dataset.truth` may take."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(synth_data.truths.__path__)))


def truth_kind(name: str) -> Truth:
    """The kind of this name. Raises InvalidInput for an unknown one, with what was perhaps meant."""
    module = import_module(f"synth_data.truths.{choose('dataset.truth', name, truth_kinds())}")
    truth: Truth = module.TRUTH
    return truth


def cast(
    name: str,
    generic: GenericRig,
    people: Mapping[str, Person],
    weights: FloatArray,
    cache: ArrayCache | None = None,
    progress: Progress = lambda line: None,
) -> dict[str, Performer]:
    """The performer of each person under the kind of truth `name`, with a line of progress for what takes long.

    weights: (N, 51) what they will be asked for. The performers can be pickled. Raises InvalidInput as `truth_kind`.
    """
    kind, cache = truth_kind(name), ArrayCache() if cache is None else cache
    performer_of = kind.prepare(generic, cache, progress)
    performers: dict[str, Performer] = {}
    for i, (person_name, person) in enumerate(people.items(), 1):
        progress(f"Truth {name}: person {i} of {len(people)}")
        performers[person_name] = performer_of(person)
        if kind.rehearsed:
            performers[person_name] = Rehearsed(performers[person_name], person_key(name, generic, person), cache)
            performers[person_name](weights)
    return performers


def person_key(name: str, generic: GenericRig, person: Person) -> str:
    """Fingerprint of what decides a person's performance under a kind of truth, apart from the weights."""
    regions, traits = encode(generic.regions), repr(person.traits)
    return fingerprint(
        [name, truth_code(), generic.neutral, generic.faces, generic.deltas, regions, person.neutral, traits]
    )


def truth_code(*packages: str) -> str:
    """SHA-256 over the code that makes frames: of every kind of truth, and of packages of a dataset's own."""
    return code_digest("synth_data.truths", *packages)
