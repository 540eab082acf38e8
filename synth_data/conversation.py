"""A conversation-like performance drawn from a seed: talking and listening, expressions, gaze and blinks over time.

Nothing of it is recorded. Each part of the face goes from target to target along minimum-jerk curves (Flash and Hogan
1985), which have a speed and an acceleration everywhere and never leave the segment between two targets. Starting
values: 3 to 4 syllables a second, so that the jaw moves at 2 to 7 Hz (Chandrasekaran et al. 2009); about 20 blinks a
minute (Bentivoglio et al. 1997) that close faster than they open. docs/sequences.md compares the statistics with a
recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from retarget.check import InvalidInput
from retarget.types import FloatArray
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.recording import ROTATIONS, Recording
from synth_data.sequence import COLUMN, PARTS, Gesture, draw_gesture, possible

Span = tuple[float, float]  # s, drawn uniformly


@dataclass(frozen=True)
class Pace:
    """Times of the gestures of a part of the face."""

    pause: float  # s before the next gesture, the mean of an exponential distribution
    rise: Span
    hold: Span
    fall: Span


PACES: dict[str, Pace] = {  # of `PARTS`; their blinks have a process of their own
    "jaw": Pace(14.0, (0.25, 0.6), (0.1, 1.0), (0.3, 0.7)),
    "mouth": Pace(3.0, (0.25, 0.7), (0.3, 2.5), (0.4, 1.0)),
    "nose": Pace(10.0, (0.2, 0.5), (0.1, 1.0), (0.3, 0.6)),
    "lids": Pace(6.0, (0.15, 0.4), (0.2, 1.5), (0.2, 0.5)),
    "gaze": Pace(1.5, (0.05, 0.10), (0.3, 1.8), (0.05, 0.10)),
    "brows": Pace(3.0, (0.15, 0.4), (0.1, 1.5), (0.2, 0.6)),
}
BLINK = Pace(2.6, (0.07, 0.11), (0.0, 0.05), (0.15, 0.25))

VOWELS: tuple[Gesture, ...] = (
    (3.0, 0.80, {"jawOpen": 1.0, "mouthLowerDown": 0.5, "mouthUpperUp": 0.2}),
    (3.0, 0.60, {"jawOpen": 0.6, "mouthStretch": 0.7, "mouthLowerDown": 0.6, "mouthUpperUp": 0.3, "mouthSmile": 0.3}),
    (2.0, 0.85, {"jawOpen": 0.6, "mouthFunnel": 0.8, "mouthPucker": 0.3}),
    (1.5, 0.90, {"jawOpen": 0.2, "mouthFunnel": 0.4, "mouthPucker": 1.0}),
    (3.0, 0.50, {"jawOpen": 1.0, "mouthLowerDown": 0.6}),
)
CONSONANTS: tuple[Gesture, ...] = (
    (2.0, 0.60, {"mouthPress": 0.7, "mouthRollLower": 0.7, "mouthRollUpper": 0.5, "jawOpen": 0.2, "mouthClose": 0.2}),
    (1.0, 0.70, {"mouthRollLower": 1.0, "mouthUpperUp": 0.4, "jawOpen": 0.1}),
    (4.0, 0.45, {"mouthStretch": 0.7, "mouthLowerDown": 0.8, "mouthShrugUpper": 0.3, "jawOpen": 0.2}),
    (1.0, 0.70, {"mouthFunnel": 1.0, "mouthShrugUpper": 0.3, "jawForward": 0.3, "jawOpen": 0.2}),
    (2.0, 0.40, {"jawOpen": 1.0, "mouthLowerDown": 0.6}),
)
SOUND: Span = (0.09, 0.14)  # s from a vowel to a consonant or back
HELD: Span = (0.00, 0.05)
SYLLABLES, PHRASES = (3, 12), (1, 5)  # in a phrase, in a turn
BREATH: Span = (0.3, 0.9)  # s between two phrases
LISTENING: Span = (2.0, 7.0)  # s between two turns
ONE_SIDED, SIDES_DIFFER = 0.05, 0.05  # less than in still expressions: the recorded sides are nearly alike

# What a unit brings along, on its own side: muscles and trackers couple units. Shares after the slopes between units
# of the recording of docs/sequences.md that correlate above 0.6, lower where both are also done alone.
COMPANIONS: dict[str, dict[str, float]] = {
    "jawOpen": {"mouthStretch": 0.4, "mouthLowerDown": 0.5},
    "mouthSmile": {"mouthUpperUp": 0.45, "mouthLowerDown": 0.25, "cheekSquint": 0.3},
    "mouthPress": {"mouthShrugLower": 0.7, "mouthDimple": 0.5},
    "mouthPucker": {"mouthFunnel": 0.3, "cheekPuff": 0.2},
    "mouthUpperUp": {"mouthShrugUpper": 0.6},
    "noseSneer": {"cheekSquint": 0.6, "browDown": 0.7, "eyeSquint": 0.5, "mouthUpperUp": 0.4},
    "browDown": {"noseSneer": 0.3, "cheekSquint": 0.2, "eyeSquint": 0.3},
    "browInnerUp": {"browOuterUp": 0.7, "eyeWide": 0.2},
}

_STREAM = 5  # of the seed
_REST = np.zeros(len(SKIN_NAMES))
_CLOSED = np.array([float(name.startswith("eyeBlink")) for name in SKIN_NAMES])
_EYES = [i for i, name in enumerate(SKIN_NAMES) if name.startswith("eye")]

# A target (51,), the time in s that the way to it takes, and the time that it is held.
_Move = tuple[FloatArray, float, float]
_Process = Callable[[np.random.Generator], Iterator[_Move]]


def conversation(seconds: float, fps: float = 30.0, seed: int = 0) -> Recording:
    """A performance of `round(seconds * fps)` rows, from rest; the tongue and the head are still.

    It is defined at any time: another rate samples the same motion, and a longer take begins with the shorter one,
    bit for bit. Raises InvalidInput for a take without a row.
    """
    count = round(seconds * fps) if 0 < fps < np.inf and 0 < seconds < np.inf else 0
    if count < 1:
        raise InvalidInput(
            f"conversation: expected a positive length in seconds and frames per second, got {seconds!r} at {fps!r}; "
            "ask for at least one frame."
        )
    times = np.arange(count) / fps

    gestures = (partial(_gestures, _without_blinks(part), pace) for part, pace in PACES.items())
    processes: tuple[_Process, ...] = (_speech, *gestures, _blinks)
    *parts, blinks = (
        _follow(times, moves(np.random.default_rng([seed, _STREAM, i]))) for i, moves in enumerate(processes)
    )
    closed = blinks[:, [COLUMN["eyeBlinkLeft"]]]
    rows = 1 - np.prod([1 - part for part in parts], axis=0)
    rows = accompanied(rows)
    rows[:, _EYES] *= 1 - closed
    rows = possible(rows + blinks)

    weights = np.zeros((count, len(NAMES)))
    weights[:, [NAMES.index(name) for name in SKIN_NAMES]] = rows
    none = np.zeros(count, dtype=bool)
    return Recording("conversation", times, weights, np.zeros((count, len(ROTATIONS))), none, none)


def accompanied(rows: FloatArray) -> FloatArray:
    """(t, 51) in [0, 1]: the rows with `COMPANIONS` of their units."""
    return 1 - (1 - rows) * (1 - (rows @ _BROUGHT).clip(0, 1))


def _brought() -> FloatArray:
    """(51, 51) how much of the units (columns) each unit (row) brings along; half, where one side moves the middle."""
    shares = np.zeros((len(SKIN_NAMES), len(SKIN_NAMES)))
    for lead, companions in COMPANIONS.items():
        for unit, share in companions.items():
            for side in ("Left", "Right"):
                row, column = (COLUMN[name if name in COLUMN else name + side] for name in (lead, unit))
                shares[row, column] += share / 2 if unit in COLUMN else share
    return shares


_BROUGHT = _brought()


def _follow(times: FloatArray, moves: Iterator[_Move]) -> FloatArray:
    """(t, 51) weights that make the moves one after the other, from rest."""
    starts, spans, targets, now = list[float](), list[float](), [_REST], 0.0
    while now <= times[-1]:
        target, span, held = next(moves)
        starts.append(now)
        spans.append(span)
        targets.append(target)
        now += span + held
    current = np.searchsorted(starts, times, side="right") - 1
    s = ((times - np.take(starts, current)) / np.take(spans, current)).clip(0, 1)[:, None]
    share = (s**3 * (10 - 15 * s + 6 * s**2)).clip(0, 1)  # minimum jerk
    reached = possible(np.array(targets))
    return (1 - share) * reached[current] + share * reached[current + 1]


def _speech(rng: np.random.Generator) -> Iterator[_Move]:
    while True:
        yield _REST, 0.2, rng.uniform(*LISTENING)
        for _ in range(rng.integers(*PHRASES, endpoint=True)):
            for gestures in (CONSONANTS, VOWELS) * int(rng.integers(*SYLLABLES, endpoint=True)):
                sound = draw_gesture(rng, gestures, one_sided=0.0, differ=SIDES_DIFFER)
                yield sound, rng.uniform(*SOUND), rng.uniform(*HELD)
            yield _REST, 0.2, rng.uniform(*BREATH)


def _gestures(gestures: Sequence[Gesture], pace: Pace, rng: np.random.Generator) -> Iterator[_Move]:
    while True:
        yield from _once(rng, draw_gesture(rng, gestures, ONE_SIDED, SIDES_DIFFER), pace)


def _blinks(rng: np.random.Generator) -> Iterator[_Move]:
    while True:
        yield from _once(rng, rng.uniform(0.85, 1.0) * _CLOSED, BLINK)


def _once(rng: np.random.Generator, target: FloatArray, pace: Pace) -> Iterator[_Move]:
    """Rest, then there and back."""
    yield _REST, 0.02, rng.exponential(pace.pause)
    yield target, rng.uniform(*pace.rise), rng.uniform(*pace.hold)
    yield _REST, rng.uniform(*pace.fall), 0.0


def _without_blinks(part: str) -> tuple[Gesture, ...]:
    return tuple(gesture for gesture in PARTS[part][1] if "eyeBlink" not in gesture[2])
