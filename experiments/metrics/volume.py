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
    corners = [frames[:, faces[:, i]] for i in range(3)]
    total = _flow(*corners)
    for rim in rims:
        start, end = frames[:, rim[:, 0]], frames[:, rim[:, 1]]
        total += _flow(end, start, np.broadcast_to(start.mean(axis=1, keepdims=True), start.shape))
    return total / 1000


def _flow(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """(t,) mm^3: the mean height of triangles (t, f, 3) mm times their area seen along z."""
    u, v = b - a, c - a
    area = (u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]) / 2
    flow: FloatArray = ((a + b + c)[..., 2] / 3 * area).sum(axis=1)
    return flow
