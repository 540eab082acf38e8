"""About twenty example expressions per identity, as a session in a scanner would collect them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from retarget.check import InvalidInput
from retarget.types import FloatArray
from synth_data.arkit import SKIN_NAMES
from synth_data.noise import ScanNoise, check_noise
from synth_data.personal.face import PersonalFace

# Units without a side are done by both. The weights are what the person was asked for, hence the estimate that
# example-based rigging starts from; gains, asymmetry and response of the person are not in them.
SCANS: Mapping[str, Mapping[str, float]] = {
    "jaw_drop": {"jawOpen": 1.0},
    "smile": {"mouthSmile": 1.0, "cheekSquint": 0.4},
    "laugh": {"mouthSmile": 0.8, "jawOpen": 0.5, "mouthUpperUp": 0.3, "cheekSquint": 0.5, "eyeSquint": 0.4},
    "smile_left": {"mouthSmileLeft": 0.9, "mouthDimpleLeft": 0.4, "cheekSquintLeft": 0.4},
    "smile_right": {"mouthSmileRight": 0.9, "mouthDimpleRight": 0.4, "cheekSquintRight": 0.4},
    "sadness": {"mouthFrown": 0.9, "browInnerUp": 0.8, "mouthShrugLower": 0.3},
    "anger": {"browDown": 1.0, "mouthPress": 0.8, "noseSneer": 0.4, "eyeSquint": 0.3},
    "disgust": {"noseSneer": 1.0, "mouthUpperUp": 0.7, "browDown": 0.4},
    "surprise": {"browInnerUp": 1.0, "browOuterUp": 1.0, "eyeWide": 1.0, "jawOpen": 0.45},
    "eyes_shut": {"eyeBlink": 1.0},
    "eyes_squeezed": {"eyeBlink": 1.0, "eyeSquint": 0.7, "cheekSquint": 0.9, "browDown": 0.6},
    "look_down": {"eyeLookDown": 1.0, "browOuterUp": 0.5},
    "pucker": {"mouthPucker": 1.0},
    "funnel": {"mouthFunnel": 1.0, "jawOpen": 0.25},
    "lips_in": {"mouthRollUpper": 1.0, "mouthRollLower": 1.0, "mouthDimple": 0.3},
    "chin_raised": {"mouthShrugLower": 1.0, "mouthShrugUpper": 0.6},
    "cheeks_puffed": {"cheekPuff": 1.0},
    "grimace": {"mouthStretch": 1.0, "mouthLowerDown": 0.7, "jawOpen": 0.15},
    "jaw_left": {"jawLeft": 1.0, "jawOpen": 0.1},
    "jaw_right": {"jawRight": 1.0, "jawOpen": 0.1},
    "jaw_forward": {"jawForward": 1.0},
    "lips_shut_jaw_open": {"jawOpen": 0.6, "mouthClose": 0.6},
    "mouth_left": {"mouthLeft": 1.0},
    "mouth_right": {"mouthRight": 1.0},
}


@dataclass(frozen=True)
class Scan:
    """One example expression."""

    name: str
    weights: FloatArray  # (51,) of `SKIN_NAMES`: what was asked for
    vertices: FloatArray  # (n, 3) mm


def unit_weights(units: Mapping[str, float]) -> FloatArray:
    """(51,) weights of `SKIN_NAMES`; a name without its side counts for both. Raises InvalidInput for unknown names."""
    weights = np.zeros(len(SKIN_NAMES))
    for name, weight in units.items():
        names = [name] if name in SKIN_NAMES else [f"{name}Left", f"{name}Right"]
        if names[-1] not in SKIN_NAMES:
            raise InvalidInput(f"units: expected names of ARKit's face units that move skin, got {name!r}.")
        weights[[SKIN_NAMES.index(each) for each in names]] = weight
    return weights


def personal_scans(face: PersonalFace, noise: float = 0.0) -> tuple[Scan, ...]:
    """The expressions of `SCANS` as one person performs them; the neutral is not among them.

    noise is the RMS length in mm of what the scanner adds to each vertex, half of its variance smooth, half white.
    The same face and noise give the same bits. Raises InvalidInput for noise below zero.
    """
    check_noise("noise", noise)
    weights = np.stack([unit_weights(units) for units in SCANS.values()])
    frames = face(weights)
    if noise > 0:
        added = ScanNoise(f"seed {face.traits.seed}", face.neutral, face.faces)
        frames = frames + noise * np.stack([added(name) for name in SCANS])
    return tuple(Scan(name, w, v) for name, w, v in zip(SCANS, weights, frames, strict=True))
