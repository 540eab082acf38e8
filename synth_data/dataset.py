"""What a study may ask of its data: one interface for every dataset and every kind of truth.

A config class (one YAML in ``conf/dataset``) has ``load(progress) -> Dataset``; all identities share faces,
regions and the list of expressions, so that frame i of one identity is the truth for frame i of another.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from retarget.check import InvalidInput
from retarget.suggest import choose
from retarget.types import FloatArray, IntArray, Pair, Regions
from synth_data.noise import ScanNoise

NEUTRAL = "neutral"  # the name under which the neutral is scanned

Progress = Callable[[str], None]  # told one line per step that takes long


@dataclass(frozen=True)
class Conditions:
    """What a result is conditional on; it travels into every row of every table."""

    dataset: str
    truth: str  # kind of ground truth, e.g. "personal_blendshapes"
    weights: str  # source of the blending weights, e.g. "sparse"
    noise_mm: float = 0.0  # RMS length of what a scanner adds to each vertex that a method sees


class Dataset(ABC):
    """Identities that perform the same expressions in one topology, in mm, stabilised on the cranium.

    `neutral` and `frames` are the truth. A method is given what a scanner sees of them, `scanned_neutral` and
    `scanned`: the same bits without noise.
    """

    conditions: Conditions
    faces: IntArray  # (f, 3)
    regions: Regions
    identities: tuple[str, ...]
    expressions: tuple[str, ...]  # N names, without the neutral
    favours: str  # one sentence for the report: which methods this truth resembles, and what it cannot show
    fingerprint: str  # SHA-256 over everything that decides the frames; equal prints mean equal data

    @abstractmethod
    def neutral(self, identity: str) -> FloatArray:
        """(n, 3) mm."""

    @abstractmethod
    def frames(self, identity: str, indices: Sequence[int]) -> FloatArray:
        """(len(indices), n, 3) mm: the expressions with these indices, neutral included in the positions."""

    def known(self, identity: str, setting: str = "identity") -> str:
        """Raises InvalidInput, which names the setting, for an identity that the dataset does not hold."""
        return choose(setting, identity, self.identities)

    def chosen(self, indices: Sequence[int], mend: str) -> IntArray:
        """(k,) indices of expressions. Raises InvalidInput, with `mend` as its last words, for one out of range."""
        chosen = np.asarray(indices, dtype=np.int64).reshape(-1)
        if len(chosen) and not 0 <= chosen.min() <= chosen.max() < len(self.expressions):
            raise InvalidInput(
                f"expressions: expected indices from 0 to {len(self.expressions) - 1}, got {chosen.min()} to "
                f"{chosen.max()}; {mend}."
            )
        return chosen

    def scanned_neutral(self, identity: str) -> FloatArray:
        """(n, 3) mm: the neutral with the scanner's noise."""
        return self.as_scanned(identity, (NEUTRAL,), self.neutral(identity)[None])[0]

    def scanned(self, identity: str, indices: Sequence[int]) -> FloatArray:
        """(len(indices), n, 3) mm: the expressions with the scanner's noise."""
        return self.as_scanned(identity, [self.expressions[i] for i in indices], self.frames(identity, indices))

    def scanned_pair(self, source: str, target: str) -> Pair:
        """Two identities as a method gets them."""
        return Pair(self.faces, self.scanned_neutral(source), self.scanned_neutral(target), self.regions)

    def as_scanned(self, identity: str, names: Sequence[str], clean: FloatArray) -> FloatArray:
        """(k, n, 3) mm: clean frames (k, n, 3) mm, scanned under these names (k,), with the noise of the conditions."""
        amount = self.conditions.noise_mm
        if amount == 0 or not len(names):
            return clean
        noise = ScanNoise(identity, self.neutral(identity), self.faces)
        scans = np.empty(clean.shape)
        for i, name in enumerate(names):
            scans[i] = clean[i] + amount * noise(name)
        return scans


@runtime_checkable
class Rigged(Protocol):
    """A dataset whose identities perform any blending weights, not only those of its expressions."""

    weights: FloatArray  # (N, 51) of `synth_data.arkit.SKIN_NAMES`, those of the expressions

    def perform(self, identity: str, weights: FloatArray) -> FloatArray:
        """(t, n, 3) mm for weights (t, 51) of `synth_data.arkit.SKIN_NAMES`, by the dataset's kind of truth."""
        ...


class DatasetConfig(ABC):
    """A frozen dataclass of settings that Hydra makes from ``conf/dataset/*.yaml``."""

    @abstractmethod
    def load(self, progress: Progress = lambda line: None) -> Dataset:
        """Read or synthesise the data. Raises InvalidInput with what to do when it cannot."""
