"""Landmarks that a person picks on a new head: their names, and whether they fit a head in mm and upright."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from retarget.check import InvalidInput
from retarget.geometry.procrustes import similarity_align
from retarget.types import FloatArray, IntArray, Regions

LANDMARKS = (
    "nasion", "pronasale", "subnasale", "stomion_upper", "menton", "cheilion_left", "cheilion_right",
    "endocanthion_left", "endocanthion_right", "exocanthion_left", "exocanthion_right", "tragion_left", "tragion_right",
    "gonion_left", "gonion_right",
)  # fmt: skip
"""What a person should pick at least; every further name of the reference makes the result better."""
LEAST = 6  # landmarks
UNITS = {"m": 1000.0, "dm": 100.0, "cm": 10.0, "inch": 25.4}  # in mm
SIZES = (0.6, 1.6)  # of a head against the reference


def check_landmarks(landmarks: Mapping[str, int], reference: Regions, vertex_count: int) -> tuple[IntArray, IntArray]:
    """The vertices (k,) of the reference and of the head; raises InvalidInput."""
    unknown = sorted(set(landmarks) - set(reference.landmarks))
    if unknown:
        raise InvalidInput(
            f"landmarks: {', '.join(unknown)} unknown, expected names of the reference such as {', '.join(LANDMARKS)}; "
            "docs/regions.md shows where each one is."
        )
    if len(landmarks) < LEAST:
        missing = [name for name in LANDMARKS if name not in landmarks]
        raise InvalidInput(
            f"landmarks: expected at least {LEAST}, got {len(landmarks)}; add some of {', '.join(missing)}."
        )
    for name, vertex in landmarks.items():
        if not 0 <= vertex < vertex_count:
            raise InvalidInput(
                f"landmarks[{name!r}]: expected a vertex from 0 to {vertex_count - 1}, got {vertex}; "
                "count from 0, in the numbers of this mesh."
            )
    return np.array([reference.landmarks[n] for n in landmarks]), np.array(list(landmarks.values()), dtype=np.int64)


def check_pose(reference: FloatArray, points: FloatArray) -> None:
    """Raises InvalidInput unless landmarks (k, 3) are in mm, +y up, +z forward and not mirrored."""
    scale, rotation, translation = similarity_align(reference, points)
    error = np.sqrt(np.mean(np.sum((scale * reference @ rotation.T + translation - points) ** 2, axis=1)))
    flipped = reference * (-1.0, 1.0, 1.0)
    other_scale, other_rotation, other_translation = similarity_align(flipped, points)
    other = flipped @ other_rotation.T * other_scale + other_translation
    if np.sqrt(np.mean(np.sum((other - points) ** 2, axis=1))) < 0.5 * error:
        raise InvalidInput(
            "landmarks: left and right are exchanged, expected the character's own left at +x; swap them."
        )
    if not SIZES[0] < scale < SIZES[1]:
        likely = [unit for unit, mm in UNITS.items() if SIZES[0] < scale * mm < SIZES[1]]
        hint = (
            f" It looks like {likely[0]}: multiply by {UNITS[likely[0]]:g} (or write the unit into the landmarks file)."
            if likely
            else " Check the landmarks."
        )
        raise InvalidInput(
            f"head: expected a head in mm, got one that is {scale:.3g} times as large as the reference head.{hint}"
        )
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    if angle > 40:
        raise InvalidInput(
            f"head: expected +y up and +z out of the face, got a head turned by {angle:.0f} degrees; turn it."
        )
    if error > 0.15 * np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))):
        worst = np.argmax(np.linalg.norm(scale * reference @ rotation.T + translation - points, axis=1))
        raise InvalidInput(
            f"landmarks: they are {error:.0f} mm off the reference's after alignment, the worst is number {worst}; "
            "a name probably sits at another place. docs/regions.md shows where each one is."
        )
