"""Axes of a face from its landmarks, so that nothing depends on how the head is turned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from retarget.types import FloatArray, Regions

Place = Mapping[str, float]  # affine combination of landmarks, named without their side


@dataclass(frozen=True)
class Frame:
    """Unit vectors to the person's left, up and forward, and the landmarks (mm) by name."""

    left: FloatArray
    up: FloatArray
    forward: FloatArray
    marks: Mapping[str, FloatArray]

    def place(self, combination: Place, side: str) -> FloatArray:
        """(3,) mm of an affine combination of landmarks; those that come in pairs are taken on `side`."""
        return np.sum(
            [
                weight * self.marks[name if name in self.marks else f"{name}_{side}"]
                for name, weight in combination.items()
            ],
            axis=0,
        )

    def local(self, vectors: FloatArray) -> FloatArray:
        """(..., 3) coordinates to the left, up and forward."""
        return vectors @ np.stack([self.left, self.up, self.forward]).T

    def world(self, coordinates: FloatArray) -> FloatArray:
        """(..., 3) the inverse of `local`."""
        return coordinates @ np.stack([self.left, self.up, self.forward])


def face_frame(vertices: FloatArray, regions: Regions) -> Frame:
    """Left from the outer corners of the eyes and the mouth, up from the chin to the nasion at right angles to it."""
    marks = {name: vertices[index] for name, index in regions.landmarks.items()}
    across = [marks[f"{name}_left"] - marks[f"{name}_right"] for name in ("exocanthion", "cheilion", "zygion")]
    left = np.sum(across, axis=0)
    left /= np.linalg.norm(left)
    up = marks["nasion"] - marks["pogonion"]
    up = up - (up @ left) * left
    up /= np.linalg.norm(up)
    return Frame(left, up, np.cross(left, up), marks)
