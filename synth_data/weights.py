"""The blending weights of a dataset's expressions: three sources behind one interface.

The same weights drive every identity, so that frame i of one is the truth for frame i of another. docs/sequences.md
shows what each source spans: a recorded take alone spans so few dimensions that many examples become trivial.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from retarget.check import InvalidInput
from retarget.suggest import choose
from retarget.types import FloatArray
from synth_data.arkit import SKIN_NAMES
from synth_data.conversation import conversation
from synth_data.recording import Recording, mirrored
from synth_data.sequence import PARTS, draw_gesture, possible, sparse_weights

TAKE = 300.0  # s of the built-in conversation, where no recording is given
MOVES, DIFFERS = 0.1, 0.02  # an expression has a weight of at least the one, and differs from all others by the other
ADDED = 3  # at most this many sparse gestures are added to recombined frames

REGIONS: Mapping[str, tuple[str, ...]] = {  # of the face, that recombined expressions take from different frames
    "brows": tuple(name for name in SKIN_NAMES if name.startswith("brow")),
    "eyes": tuple(name for name in SKIN_NAMES if name.startswith("eye")),
    "nose": tuple(name for name in SKIN_NAMES if name.startswith(("nose", "cheekSquint"))),
    "jaw": tuple(name for name in SKIN_NAMES if name.startswith("jaw") or name == "mouthClose"),
    "mouth": tuple(
        name for name in SKIN_NAMES if name == "cheekPuff" or (name.startswith("mouth") and name != "mouthClose")
    ),
}

_STREAM = 7  # of the seed


def blending_weights(source: str, count: int, seed: int = 0, recording: Recording | None = None) -> FloatArray:
    """(count, 51) weights of `SKIN_NAMES` in [0, 1], of one of `SOURCES`; the first rows do not depend on `count`.

    Without a recording its frames are those of the built-in conversation. Raises InvalidInput for an unknown source,
    a recording that the source does not use, and one with fewer than `count` different frames.
    """
    return SOURCES[choose("weights", source, SOURCES)](count, seed, recording)


def _sparse(count: int, seed: int, recording: Recording | None) -> FloatArray:
    if recording is not None:
        raise InvalidInput(
            f"weights: 'sparse' draws its expressions and uses no recording, got '{recording.name}'; choose recorded "
            "or recombined, or leave the recording out."
        )
    return sparse_weights(count, seed)


def _recorded(count: int, seed: int, recording: Recording | None) -> FloatArray:
    """Different frames of the recording, in random order."""
    frames = _frames(seed, recording)
    order = np.random.default_rng([seed, _STREAM]).permutation(len(frames))
    rows = _different(frames[order], count)
    if len(rows) < count:
        name = recording.name if recording else "the built-in conversation"
        raise InvalidInput(
            f"weights: expected {count} different expressions, but '{name}' has {len(rows)} among its {len(frames)} "
            "tracked frames; ask for fewer (dataset.expressions), record more, or choose recombined."
        )
    return rows


def _recombined(count: int, seed: int, recording: Recording | None) -> FloatArray:
    """Each region of the face from a frame of its own, mirrored or not, and up to `ADDED` sparse gestures on top."""
    return _different(_recombinations(seed, _frames(seed, recording)), count)


def _recombinations(seed: int, frames: FloatArray) -> Iterator[FloatArray]:
    rng = np.random.default_rng([seed, _STREAM])
    both = np.stack([frames, mirrored(frames)])
    regions = [[SKIN_NAMES.index(name) for name in names] for names in REGIONS.values()]
    gestures = [gestures for _, gestures in PARTS.values()]
    while True:
        row = np.zeros(len(SKIN_NAMES))
        for columns in regions:
            row[columns] = both[rng.integers(2), rng.integers(len(frames)), columns]
        for _ in range(rng.integers(ADDED, endpoint=True)):
            row = np.maximum(row, draw_gesture(rng, gestures[rng.integers(len(gestures))]))
        yield possible(row)


SOURCES: Mapping[str, Callable[[int, int, Recording | None], FloatArray]] = {
    "sparse": _sparse,
    "recombined": _recombined,
    "recorded": _recorded,
}


def _frames(seed: int, recording: Recording | None) -> FloatArray:
    """(t, 51) tracked frames."""
    take = conversation(TAKE, seed=seed) if recording is None else recording
    return take.skin[~take.lost]


def _different(rows: FloatArray | Iterator[FloatArray], count: int) -> FloatArray:
    """(k <= count, 51) the first rows that move the face and differ from all before."""
    chosen = np.empty((count, len(SKIN_NAMES)))
    k = 0
    for row in rows if count else ():
        if row.max() >= MOVES and (np.abs(chosen[:k] - row).max(axis=1) >= DIFFERS).all():
            chosen[k] = row
            k += 1
            if k == count:
                break
    return chosen[:k]
