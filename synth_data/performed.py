"""Datasets whose people perform weights of ARKit's face units: settings, checks and frames that they have in common.

Such a dataset is its people at rest (`Troupe`); how they move is `dataset.truth`, and what they are asked for
`dataset.weights`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar

import numpy as np
from threadpoolctl import threadpool_limits

from retarget.check import InvalidInput, check_triangle_areas, check_vertices, check_whole
from retarget.suggest import choose
from retarget.types import FloatArray, IntArray, Regions
from synth_data.cache import ArrayCache, fingerprint
from synth_data.dataset import Conditions, Dataset, DatasetConfig, Progress
from synth_data.live_link import read_live_link
from synth_data.noise import check_noise
from synth_data.recording import Recording
from synth_data.truth import GenericRig, Performer, Person, cast, truth_code, truth_kind, truth_kinds
from synth_data.weights import SOURCES, blending_weights


def as_is(vertices: FloatArray) -> FloatArray:
    """A topology that is not refined."""
    return vertices


@dataclass(frozen=True)
class Troupe:
    """People at rest on the topology of their generic rig, and the topology of the dataset's frames."""

    generic: GenericRig
    people: Mapping[str, Person]  # by identity
    faces: IntArray  # (f, 3) of the frames
    regions: Regions  # of the frames
    refine: Callable[[FloatArray], FloatArray] = as_is  # vertices (..., n, 3) mm of the rig to those of the frames


@dataclass(frozen=True)
class PerformedConfig(DatasetConfig):
    """Settings of a dataset whose people perform expressions. Seeds count from 0 in studies, from 1000 in tuning."""

    identities: int = 4
    first_seed: int = 0  # identity i has seed first_seed + i
    expressions: int = 250
    expression_seed: int = 0
    truth: str = "ebfr_arkit"  # one of `synth_data.truth.truth_kinds`
    weights: str = "recombined"  # one of `synth_data.weights.SOURCES`
    recording: str | None = None  # a Live Link Face CSV for recorded and recombined; by default a built-in conversation
    noise_mm: float = 0.0  # RMS length of scan noise in all that methods see; the truth has none
    cache: str | None = None  # a folder; by default the user's

    name: ClassVar[str]  # of the dataset
    paths: ClassVar[Mapping[str, str]] = {"recording": "a Live Link Face CSV", "cache": "a folder"}
    package: ClassVar[str]  # of its code and data
    # What decides no frames: an identity's name holds its seed, and files count by their contents.
    elsewhere: ClassVar[frozenset[str]] = frozenset({"identities", "first_seed", "recording", "noise_mm", "cache"})

    @abstractmethod
    def source(self) -> str:
        """Digest of the files that people are made from. Raises InvalidInput where they cannot be used."""

    @abstractmethod
    def troupe(self, progress: Progress) -> Troupe:
        """The people, one for each seed of `seeds`. Raises InvalidInput where they cannot be made."""

    def seeds(self) -> Mapping[str, int]:
        """The seed of each identity, by name."""
        return {f"person-{seed:03d}": seed for seed in range(self.first_seed, self.first_seed + self.identities)}

    def expression_names(self) -> tuple[str, ...]:
        """The name of each expression."""
        return tuple(f"{self.weights}-{i:03d}" for i in range(self.expressions))

    @threadpool_limits.wrap(limits=1)  # the same bits however many cores there are
    def load(self, progress: Progress = lambda line: None) -> PerformedDataset:
        """Synthesise people and truth. Raises InvalidInput for settings out of range, and as `troupe`."""
        self.check()
        take = None if self.recording is None else read_live_link(Path(self.recording).expanduser())
        if take is not None:
            progress(f"recording {take.summary}")
        weights = blending_weights(self.weights, self.expressions, self.expression_seed, take)
        troupe = self.troupe(progress)
        neutrals = {name: check_vertices(name, troupe.refine(person.neutral)) for name, person in troupe.people.items()}
        for name, neutral in neutrals.items():
            check_triangle_areas(name, neutral, troupe.faces)
        kept = ArrayCache.of(self.cache)
        return PerformedDataset(
            conditions=Conditions(
                self.name, self.truth, f"{self.weights}:{take.name}" if take else self.weights, float(self.noise_mm)
            ),
            faces=troupe.faces,
            regions=troupe.regions,
            identities=tuple(neutrals),
            expressions=self.expression_names(),
            favours=_with_recording(truth_kind(self.truth).favours, take),
            fingerprint=self._fingerprint(take),
            neutrals=neutrals,
            performers=cast(self.truth, troupe.generic, troupe.people, weights, kept, progress),
            weights=weights,
            refine=troupe.refine,
        )

    def check(self) -> None:
        """Raises InvalidInput for a setting out of range."""
        for name, lowest in (("identities", 1), ("first_seed", 0), ("expressions", 1), ("expression_seed", 0)):
            check_whole(f"dataset.{name}", getattr(self, name), lowest)
        for name, valid in (("truth", truth_kinds()), ("weights", SOURCES)):
            if not isinstance(value := getattr(self, name), str):
                raise InvalidInput(f"dataset.{name}: expected one of {', '.join(valid)}, got {value!r}.")
        for name, what in self.paths.items():
            if not isinstance(value := getattr(self, name), str | None):
                raise InvalidInput(f"dataset.{name}: expected the path of {what}, or null, got {value!r}.")
        check_noise("dataset.noise_mm", self.noise_mm)
        truth_kind(self.truth)
        choose("dataset.weights", self.weights, SOURCES)

    def _fingerprint(self, take: Recording | None = None) -> str:
        """SHA-256 over all that decides frames: files, settings, a recording, and the code and data that make them."""
        settings = {field.name: getattr(self, field.name) for field in fields(self) if field.name not in self.elsewhere}
        taken = np.empty(0) if take is None else take.skin[~take.lost]
        return fingerprint([self.source(), repr((settings, float(self.noise_mm))), taken, truth_code(self.package)])


def _with_recording(favours: str, take: Recording | None) -> str:
    return favours if take is None else f"{favours} The expressions come from the recording {take.summary}."


@dataclass(frozen=True, eq=False)
class PerformedDataset(Dataset):
    """The loaded dataset. Frames are performed on the rig's topology when they are asked for, and then refined."""

    conditions: Conditions
    faces: IntArray
    regions: Regions
    identities: tuple[str, ...]
    expressions: tuple[str, ...]
    favours: str
    fingerprint: str
    neutrals: Mapping[str, FloatArray]  # (n, 3) mm by identity
    performers: Mapping[str, Performer]  # by identity, on the rig's topology
    weights: FloatArray  # (N, 51) of `synth_data.arkit.SKIN_NAMES`
    refine: Callable[[FloatArray], FloatArray]

    def neutral(self, identity: str) -> FloatArray:
        return self.neutrals[self.known(identity)]

    def frames(self, identity: str, indices: Sequence[int]) -> FloatArray:
        return self.perform(identity, self.weights[self.chosen(indices, "raise `dataset.expressions`")])

    @threadpool_limits.wrap(limits=1)
    def perform(self, identity: str, weights: FloatArray) -> FloatArray:
        """(t, n, 3) mm for weights (t, 51) of `synth_data.arkit.SKIN_NAMES`: `synth_data.dataset.Rigged`."""
        return self.refine(self.performers[self.known(identity)](weights))
