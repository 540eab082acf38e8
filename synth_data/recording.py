"""The weights of a face over time, whether recorded or generated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retarget.types import FloatArray
from synth_data.arkit import MIRRORED, NAMES, SKIN_NAMES

ROTATIONS: tuple[str, ...] = tuple(
    part + angle for part in ("head", "leftEye", "rightEye") for angle in ("Yaw", "Pitch", "Roll")
)


@dataclass(frozen=True, eq=False)
class Recording:
    """t rows of the 52 face units. Rows need not be evenly spaced in time: trackers drop frames."""

    name: str
    times: FloatArray  # (t,) s, from 0, increasing
    weights: FloatArray  # (t, 52) of `names` in [0, 1]
    rotations: FloatArray  # (t, 9) of `ROTATIONS`, as recorded; 0 where the file has none
    lost: NDArray[np.bool_]  # (t,) rows without tracking; their weights lie between those of their neighbours
    clipped: NDArray[np.bool_]  # (t,) rows in which a value lay outside [0, 1] and was clipped
    names: tuple[str, ...] = NAMES
    extent: tuple[float, float] = (0.0, 1.0)  # the lowest and the highest weight before clipping

    @property
    def fps(self) -> float:
        """The nominal rate in frames per second, whole; dropped frames do not lower it."""
        return float(np.round(1 / np.median(np.diff(self.times))))

    @property
    def summary(self) -> str:
        """How much of it was mended, in a line for the user, with a warning where that is most of it."""
        rows, lost, clipped = len(self.times), int(self.lost.sum()), int(self.clipped.sum())
        line = f"{self.name}: {rows:,} rows, {lost:,} lost, {clipped:,} clipped"
        if clipped:
            line += f" (values from {self.extent[0]:.4g} to {self.extent[1]:.4g})"
        if 2 * clipped > rows - lost:
            line += "; warning: most rows leave [0, 1], check that these are weights of ARKit"
        if 2 * lost > rows:
            line += "; warning: most rows are lost, check that the face was in view"
        return line

    @property
    def skin(self) -> FloatArray:
        """(t, 51) weights of `SKIN_NAMES`."""
        return self.weights[:, [self.names.index(name) for name in SKIN_NAMES]]

    def at(self, times: ArrayLike) -> FloatArray:
        """(k, 52) weights at these times in s, linear between the rows, held before the first and after the last."""
        at = np.asarray(times, dtype=np.float64)
        return np.stack([np.interp(at, self.times, column) for column in self.weights.T], axis=1)


def mirrored(weights: FloatArray, names: tuple[str, ...] = SKIN_NAMES) -> FloatArray:
    """(..., len(names)) the same weights with left and right exchanged, by name."""
    return weights[..., [names.index(MIRRORED[name]) for name in names]]
