"""An animation that every identity of a dataset performs, as further expressions of that dataset."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray, Regions
from synth_data.conversation import conversation
from synth_data.dataset import Conditions, Dataset, Rigged
from synth_data.live_link import read_live_link
from synth_data.recording import Recording

LEAST = 200  # frames: fewer show little of how a method behaves over time


@dataclass(frozen=True, eq=False)
class Take:
    """Weights at a steady rate."""

    name: str
    fps: float
    weights: FloatArray  # (t, 51) of `synth_data.arkit.SKIN_NAMES`

    @property
    def times(self) -> FloatArray:
        """(t,) s."""
        times: FloatArray = np.arange(len(self.weights)) / self.fps
        return times


def take(recording: str | None, start: float, seconds: float, fps: float | None, seed: int) -> Take:
    """`seconds` of a Live Link Face CSV from `start` on, or of the built-in conversation with this seed (None).

    At `fps` frames per second, by default the recording's own, or 30. Raises InvalidInput for values out of range,
    for a file as `read_live_link` does, for a part beyond its end, and for fewer than 200 frames.
    """
    rates = {} if fps is None else {"fps": fps}
    for name, value in {"start": start, "seconds": seconds, **rates}.items():
        above = -1e-9 if name == "start" else 0.0
        if not isinstance(value, int | float) or isinstance(value, bool) or not above < value < np.inf:
            raise InvalidInput(f"study.{name}: expected {'0 or more' if above < 0 else 'more than 0'}, got {value!r}.")
    end = start + seconds
    played = conversation(end, 60.0, seed) if recording is None else read_live_link(Path(recording).expanduser())
    rate = float(fps or (30.0 if recording is None else played.fps))
    count = round(seconds * rate)
    if count < LEAST:
        raise InvalidInput(
            f"study.seconds: expected an animation of at least {LEAST} frames, got {count} ({seconds:g} s at {rate:g} "
            "frames per second); ask for more seconds."
        )
    last = float(played.times[-1])
    if recording is not None and start + (count - 1) / rate > last + 1e-6:
        raise InvalidInput(
            f"study.seconds: '{played.name}' ends after {last:.1f} s, but {start:g} to {end:g} s are asked for; "
            "choose an earlier study.start or fewer seconds."
        )
    return Take(played.name, rate, _skin(played, start + np.arange(count) / rate))


def _skin(played: Recording, times: FloatArray) -> FloatArray:
    none = np.zeros(len(times), dtype=bool)
    return Recording(played.name, times, played.at(times), np.zeros((len(times), 9)), none, none, played.names).skin


@dataclass(frozen=True, eq=False)
class Animated(Dataset):
    """A dataset with the frames of a take after its own expressions."""

    base: Dataset
    performed: Take
    conditions: Conditions
    faces: IntArray
    regions: Regions
    identities: tuple[str, ...]
    expressions: tuple[str, ...]
    favours: str
    fingerprint: str

    @staticmethod
    def of(base: Dataset, performed: Take) -> Animated:
        """Raises InvalidInput for a dataset without rigs."""
        if not isinstance(base, Rigged):
            raise InvalidInput(
                f"dataset {base.conditions.dataset}: study=temporal needs identities that perform any blending "
                "weights, this one holds fixed expressions without an order in time. Choose a dataset with rigs, such "
                "as dataset=makehuman."
            )
        frames = tuple(f"frame-{i:04d}" for i in range(len(performed.weights)))
        digest = hashlib.sha256(base.fingerprint.encode() + np.ascontiguousarray(performed.weights).tobytes())
        return Animated(
            base,
            performed,
            base.conditions,
            base.faces,
            base.regions,
            base.identities,
            (*base.expressions, *frames),
            base.favours,
            digest.hexdigest(),
        )

    def neutral(self, identity: str) -> FloatArray:
        return self.base.neutral(identity)

    def frames(self, identity: str, indices: Sequence[int]) -> FloatArray:
        chosen, own = np.asarray(indices, dtype=np.int64).reshape(-1), len(self.base.expressions)
        frames = np.empty((len(chosen), *self.neutral(identity).shape))
        still = chosen < own
        frames[still] = self.base.frames(identity, chosen[still].tolist())
        base: Any = self.base  # Rigged: `of` has seen to it
        frames[~still] = base.perform(identity, self.performed.weights[chosen[~still] - own])
        return frames
