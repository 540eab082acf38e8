"""Blending weights of conversation-like expressions, drawn from a seed: sparse, correlated between the sides.

The same weights drive every identity, so that frame i of one is the truth for frame i of another. They are
drawn, not recorded: a few face units of each part of the face are active at a time, the two sides nearly alike,
and units that one face cannot do together exclude each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from retarget.types import FloatArray
from synth_data.arkit import SKIN_NAMES

# Each part of the face: how often it is active, and its gestures (frequency, peak, units with their share).
# A gesture named without a side is done by both sides, nearly alike.
Gesture = tuple[float, float, dict[str, float]]
PARTS: dict[str, tuple[float, tuple[Gesture, ...]]] = {
    "jaw": (0.75, (
        (6.0, 0.75, {"jawOpen": 1.0}),
        (1.5, 0.60, {"jawOpen": 1.0, "jawForward": 0.5}),
        (1.5, 0.60, {"jawOpen": 1.0, "mouthClose": 0.7}),
        (0.8, 0.60, {"jawForward": 1.0}),
        (0.7, 0.60, {"jawLeft": 1.0, "jawOpen": 0.4}),
        (0.7, 0.60, {"jawRight": 1.0, "jawOpen": 0.4}),
    )),
    "mouth": (0.90, (
        (4.0, 0.95, {"mouthSmile": 1.0, "cheekSquint": 0.5, "mouthDimple": 0.3}),
        (2.0, 0.70, {"mouthSmile": 1.0, "mouthUpperUp": 0.6}),
        (2.0, 0.85, {"mouthFrown": 1.0, "mouthShrugLower": 0.5}),
        (2.0, 0.90, {"mouthFunnel": 1.0}),
        (2.0, 0.95, {"mouthPucker": 1.0}),
        (1.5, 0.80, {"mouthFunnel": 0.6, "mouthPucker": 0.8}),
        (2.0, 0.80, {"mouthStretch": 1.0, "mouthLowerDown": 0.5}),
        (1.5, 0.85, {"mouthLowerDown": 1.0, "mouthUpperUp": 0.6}),
        (1.5, 0.85, {"mouthPress": 1.0}),
        (1.2, 0.80, {"mouthRollLower": 1.0, "mouthRollUpper": 0.7}),
        (1.2, 0.80, {"mouthShrugUpper": 0.7, "mouthShrugLower": 1.0}),
        (1.2, 0.80, {"mouthDimple": 1.0}),
        (1.0, 0.80, {"mouthLeft": 1.0, "mouthSmileLeft": 0.4}),
        (1.0, 0.80, {"mouthRight": 1.0, "mouthSmileRight": 0.4}),
        (1.0, 0.90, {"cheekPuff": 1.0, "mouthPress": 0.4}),
    )),
    "nose": (0.20, (
        (1.0, 0.80, {"noseSneer": 1.0, "mouthUpperUp": 0.4}),
        (0.5, 0.80, {"noseSneer": 1.0, "cheekSquint": 0.6}),
    )),
    "lids": (0.55, (
        (3.0, 1.00, {"eyeBlink": 1.0}),
        (2.0, 0.85, {"eyeSquint": 1.0}),
        (1.5, 0.90, {"eyeWide": 1.0}),
        (1.0, 0.80, {"eyeSquint": 0.7, "cheekSquint": 0.8}),
    )),
    "gaze": (0.40, (
        (1.0, 0.80, {"eyeLookDown": 1.0}),
        (1.0, 0.80, {"eyeLookUp": 1.0}),
        (1.0, 0.80, {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0}),
        (1.0, 0.80, {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0}),
    )),
    "brows": (0.55, (
        (2.0, 0.90, {"browInnerUp": 1.0, "browOuterUp": 0.8}),
        (1.5, 0.90, {"browInnerUp": 1.0}),
        (1.0, 0.85, {"browOuterUp": 1.0}),
        (2.0, 0.90, {"browDown": 1.0}),
    )),
}  # fmt: skip
ONE_SIDED = 0.12  # how often a gesture of both sides is done by one
SIDES_DIFFER = 0.12  # deviation of a side's share from 1

# Units that are not strong together: the sum of each set is kept at 1 or below.
EXCLUSIVE: tuple[tuple[str, ...], ...] = (
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    *(
        tuple(name + side for name in names)
        for side in ("Left", "Right")
        for names in (
            ("eyeBlink", "eyeWide"),
            ("eyeBlink", "eyeSquint"),
            ("eyeBlink", "eyeLookDown"),
            ("eyeLookIn", "eyeLookOut"),
            ("eyeLookUp", "eyeLookDown"),
            ("eyeSquint", "eyeWide"),
            ("mouthSmile", "mouthFrown"),
            ("browDown", "browOuterUp"),
        )
    ),
    *((funnel, f"mouthSmile{side}") for funnel in ("mouthFunnel", "mouthPucker") for side in ("Left", "Right")),
    ("browInnerUp", "browDownLeft"),
    ("browInnerUp", "browDownRight"),
    ("cheekPuff", "mouthFunnel"),
    ("cheekPuff", "jawOpen"),
)


def sparse_weights(count: int, seed: int = 0) -> FloatArray:
    """(count, 51) weights of `SKIN_NAMES` in [0, 1]; every row differs, has a motion, and keeps `EXCLUSIVE`.

    The first rows do not depend on `count`.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, _STREAM]))
    rows: list[FloatArray] = []
    while len(rows) < count:
        row = _expression(rng)
        active = np.count_nonzero(row)
        if 3 <= active <= 12 and not any(np.abs(row - other).max() < 0.02 for other in rows):
            rows.append(row)
    return np.array(rows).reshape(count, len(SKIN_NAMES))


_STREAM = 3  # of the seed
COLUMN = {name: i for i, name in enumerate(SKIN_NAMES)}


def _expression(rng: np.random.Generator) -> FloatArray:
    """(51,) one gesture, or none, of each part of the face."""
    row = np.zeros(len(SKIN_NAMES))
    for frequency, gestures in PARTS.values():
        if rng.random() <= frequency:
            row = np.maximum(row, draw_gesture(rng, gestures))
    row[row < 0.02] = 0.0
    return possible(row).round(4)


def draw_gesture(
    rng: np.random.Generator, gestures: Sequence[Gesture], one_sided: float = ONE_SIDED, differ: float = SIDES_DIFFER
) -> FloatArray:
    """(51,) one of the gestures, of a random strength; where several of its units are one, the strongest counts."""
    row = np.zeros(len(SKIN_NAMES))
    odds = np.array([gesture[0] for gesture in gestures])
    _, peak, units = gestures[rng.choice(len(gestures), p=odds / odds.sum())]
    strength = peak * rng.beta(1.6, 1.3)
    alone = rng.choice(["Left", "Right"]) if rng.random() < one_sided else None
    for name, share in units.items():
        amount = strength * share * np.exp(rng.normal(0, 0.15))
        if name in COLUMN:
            _raise(row, name, amount)
            continue
        for side, tilt in (("Left", rng.normal(0, differ)), ("Right", rng.normal(0, differ))):
            if alone is None or side == alone:
                _raise(row, name + side, amount * (1 + tilt))
    return row


def possible(rows: FloatArray) -> FloatArray:
    """(..., 51) the rows with `EXCLUSIVE` units scaled to a sum of 1 and mouthClose lowered to jawOpen."""
    rows = rows.copy()
    for names in EXCLUSIVE:
        columns = [COLUMN[name] for name in names]
        rows[..., columns] /= np.maximum(1.0, rows[..., columns].sum(axis=-1, keepdims=True))
    close, jaw = COLUMN["mouthClose"], COLUMN["jawOpen"]
    rows[..., close] = np.minimum(rows[..., close], rows[..., jaw])
    return rows


def _raise(row: FloatArray, name: str, amount: float) -> None:
    row[COLUMN[name]] = min(1.0, max(row[COLUMN[name]], amount))
