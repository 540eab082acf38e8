"""What is performed over time: the expressions of a dataset in turn, or a take of blending weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from retarget.check import InvalidInput
from retarget.suggest import nearest
from retarget.types import FloatArray, IntArray
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.conversation import conversation
from synth_data.dataset import Dataset, Rigged
from synth_data.live_link import is_file, read_live_link
from synth_data.recording import Recording

CONVERSATION = "conversation"  # the name of the built-in take
PER_SECOND = 2.0  # expressions, which have no order in time: half a second to see each
SECONDS = 10.0  # of the built-in take, unless told otherwise

_SKIN = [NAMES.index(name) for name in SKIN_NAMES]


@dataclass(frozen=True, eq=False)
class Motion:
    """Frames that any identity of a dataset performs."""

    names: tuple[str, ...]  # t
    times: FloatArray  # (t,) s
    expressions: tuple[int, ...] | None  # of the dataset; None: `weights` are performed
    weights: FloatArray | None  # (t, 52) of `synth_data.arkit.NAMES`; None: unknown, the dataset holds scans
    recording: str | None = None  # how much of a recorded take was mended

    @property
    def count(self) -> int:
        return len(self.times)

    def only(self, rows: IntArray) -> Motion:
        """Some of the frames."""
        return Motion(
            tuple(self.names[i] for i in rows),
            self.times[rows],
            None if self.expressions is None else tuple(self.expressions[i] for i in rows),
            None if self.weights is None else self.weights[rows],
            self.recording,
        )

    def performed(self, dataset: Dataset, identity: str) -> FloatArray:
        """(t, n, 3) mm: the truth. Raises InvalidInput for a take and a dataset without rigs."""
        if self.expressions is not None:
            # All at once: a kind of truth that takes long keeps the performance of all expressions in its cache.
            return dataset.frames(identity, range(len(dataset.expressions)))[list(self.expressions)]
        assert self.weights is not None
        return rigged(dataset).perform(identity, self.weights[:, _SKIN])


def rigged(dataset: Dataset) -> Rigged:
    """The dataset, if its identities perform any weights. Raises InvalidInput."""
    if not isinstance(dataset, Rigged):
        raise InvalidInput(
            f"dataset {dataset.conditions.dataset}: its truth is '{dataset.conditions.truth}', expressions without "
            "rigs that could perform other weights. Export its expressions (what=truth), or choose a dataset with rigs "
            "such as dataset=makehuman."
        )
    return dataset


def in_turn(dataset: Dataset, frames: Any = None, fps: float | None = None) -> Motion:
    """The chosen expressions, `fps` per second."""
    chosen = select(frames, dataset.expressions)
    weights = None
    if isinstance(dataset, Rigged) and dataset.weights.shape[1] == len(SKIN_NAMES):
        weights = np.zeros((len(chosen), len(NAMES)))
        weights[:, _SKIN] = dataset.weights[chosen]
    names = tuple(dataset.expressions[i] for i in chosen)
    return Motion(names, one_by_one(len(chosen), fps), tuple(chosen), weights)


def one_by_one(count: int, fps: float | None) -> FloatArray:
    """(count,) s at which expressions are shown."""
    return np.arange(count) / (fps or PER_SECOND)


def taken(take: str, frames: Any = None, fps: float | None = None, seconds: float | None = None) -> Motion:
    """The chosen rows of a Live Link Face CSV, or of the built-in conversation, at the take's own frame rate or `fps`.

    Rows without tracking lie between their neighbours. Raises InvalidInput as `read_live_link`.
    """
    recording = _recording(take, fps, seconds)
    times, weights = recording.times, recording.weights
    if fps is not None:
        times = np.arange(int(np.floor(times[-1] * fps + 1e-6)) + 1) / fps
        weights = recording.at(times)
    if seconds is not None:
        within = times < seconds
        times, weights = times[within], weights[within]
    names = tuple(f"{recording.name}-{i:04d}" for i in range(len(times)))
    chosen = select(frames, names)
    mended = None if take == CONVERSATION else recording.summary
    return Motion(tuple(names[i] for i in chosen), times[chosen] - times[chosen[0]], None, weights[chosen], mended)


def _recording(take: str, fps: float | None, seconds: float | None) -> Recording:
    if take == CONVERSATION:
        return conversation(seconds or SECONDS, fps or 30.0)
    path = Path(take).expanduser()
    if not is_file(path):
        raise InvalidInput(
            f"take: expected a CSV file of Live Link Face or '{CONVERSATION}', found no file '{take}'; check the path."
        )
    return read_live_link(path)


def select(frames: Any, names: Sequence[str]) -> list[int]:
    """Numbers of the chosen names: all for None; `first:end:step` as Python counts; a name, a number or a list of them.

    Raises InvalidInput for what is unknown, given twice, out of order, or nothing.
    """
    if frames is None:
        return list(range(len(names)))
    if isinstance(frames, str) and ":" in frames:
        return _slice(frames, len(names))
    listed = list(frames) if isinstance(frames, Sequence) and not isinstance(frames, str) else [frames]
    chosen = [_number(frame, names) for frame in listed]
    if not chosen or (np.diff(chosen) <= 0).any():
        raise InvalidInput(f"frames: expected one or more, in ascending order and each once, got {frames}.")
    return chosen


def _slice(frames: str, count: int) -> list[int]:
    try:
        chosen = list(range(count))[slice(*(int(part) if part else None for part in frames.split(":")))]
    except (ValueError, TypeError) as error:
        raise InvalidInput(f"frames: expected first:end or first:end:step such as 0:50, got '{frames}'.") from error
    if not chosen or (len(chosen) > 1 and chosen[1] < chosen[0]):
        raise InvalidInput(f"frames: '{frames}' names none of 0 to {count - 1} in ascending order.")
    return chosen


def _number(frame: Any, names: Sequence[str]) -> int:
    if isinstance(frame, int) and not isinstance(frame, bool):
        if not 0 <= frame < len(names):
            raise InvalidInput(f"frames: expected numbers from 0 to {len(names) - 1}, got {frame}.")
        return frame
    name = str(frame)
    if name not in names:
        raise InvalidInput(
            f"frames: '{name}' is unknown, expected a number from 0 to {len(names) - 1}, 0:50, or a name such as "
            f"'{names[0]}'.{nearest(name, names)}"
        )
    return list(names).index(name)
