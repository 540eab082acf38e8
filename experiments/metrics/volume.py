"""Volume within the skin: tissue hardly changes its volume, whatever the face does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric
from experiments.metrics.topology import open_rims
from retarget.types import FloatArray, IntArray


@dataclass(frozen=True)
class Volume(Metric):
    """Volume within the whole surface, each open border closed by triangles about its centre, in cm^3.

    `volume_error` is |V(prediction) - V(truth)|, `volume_change` V(prediction) - V(neutral), zero for tissue that
    keeps its volume and bones that are carried along. The mouth cavity is a part of the surface, so that an open mouth
    is no volume, but its walls are hidden and no other metric looks at them. It cannot see gains and losses that
    cancel, and no rigid motion; `tissue` looks at each tet.
    """

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        rims = open_rims(comparison.faces, np.arange(len(comparison.target_neutral)))
        found, true, rest = (
            volume(frames, comparison.faces, rims)
            for frames in (comparison.retargeted, comparison.truth, comparison.target_neutral[None])
        )
        yield Measurement("volume_error", "all", "cm^3", "lower", np.abs(found - true))
        yield Measurement("volume_change", "all", "cm^3", "zero", found - rest)


def volume(frames: FloatArray, faces: IntArray, rims: Sequence[IntArray]) -> FloatArray:
    """(t,) cm^3 within frames (t, n, 3) mm of triangles (f, 3), closed at its rims: the flow of (0, 0, z) outward."""
    total = np.empty(len(frames))
    for i, frame in enumerate(frames):
        x, y, z = np.ascontiguousarray(frame.T)
        total[i] = _flow(*((x[corner], y[corner], z[corner]) for corner in faces.T))
        for start, end in (rim.T for rim in rims):
            centre = x[start].mean(), y[start].mean(), z[start].mean()
            total[i] += _flow((x[end], y[end], z[end]), (x[start], y[start], z[start]), centre)
    return total / 1000


def _flow(a: Sequence[FloatArray], b: Sequence[FloatArray], c: Sequence[FloatArray]) -> float:
    """mm^3: the mean height of triangles times their area seen along z; corners are x, y and z (f,) mm."""
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return float((a[2] + b[2] + c[2]) @ area / 6)
