"""What a scanner adds to each vertex: half of its variance smooth over the skin, half white."""

from __future__ import annotations

import math

import numpy as np

from retarget.check import InvalidInput
from retarget.geometry.laplacian import heat
from retarget.types import FloatArray, IntArray

SMOOTH = 15.0  # mm over which the smooth half changes
_STREAM = 6  # sets these draws apart from others that are seeded by names


class ScanNoise:
    """The noise of one person's scans, with the smoothing over the skin factorised once."""

    def __init__(self, person: str, neutral: FloatArray, faces: IntArray) -> None:
        """neutral (n, 3) mm without noise, faces (f, 3)."""
        self.person = person
        self._shape = neutral.shape
        self._blur = heat(neutral, faces, SMOOTH)

    def __call__(self, scan: str) -> FloatArray:
        """(n, 3) mm, RMS length 1 (within about 1 %): that of the scan with this name, for noise of 1 mm.

        The draw depends on the two names alone: noise of 0.1 and of 0.3 mm is the same noise scaled, in every process
        and for any order of asking.
        """
        entropy = [_STREAM, len(self.person), *self.person.encode(), *scan.encode()]
        smooth, white = np.random.default_rng(np.random.SeedSequence(entropy)).standard_normal((2, *self._shape))
        smooth = self._blur(smooth)
        parts = [part / np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in (smooth, white)]
        return np.asarray(np.sqrt(0.5) * (parts[0] + parts[1]))


def check_noise(name: str, noise_mm: object) -> float:
    """Raises InvalidInput unless noise is a length in mm."""
    number = isinstance(noise_mm, int | float) and not isinstance(noise_mm, bool)
    if not number or not 0 <= noise_mm < math.inf:  # type: ignore[operator]
        raise InvalidInput(f"{name}: expected millimetres from 0 on, got {noise_mm!r}; 0.1 and 0.3 are usual.")
    return float(noise_mm)  # type: ignore[arg-type]
