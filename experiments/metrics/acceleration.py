"""How restless an animation is, beside the true one and the source's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, check_ordered, lacking
from retarget.types import FloatArray, Regions

STILL = 1e-3  # mm per frame^2: a sequence that accelerates less counts as accelerating by this much


@dataclass(frozen=True)
class Acceleration(Metric):
    """Second differences of an animation, as root mean squares over the vertices of a region.

    `acceleration_error` is |a(prediction) - a(truth)| in % of the truth's mean over the animation: 100 is what a face
    that does not move gets. `acceleration_excess` is |a(prediction)| - |a(truth)| over the source's mean, without
    unit: above 0 for jitter, below 0 for a motion that was smoothed away. Neither sees an offset or slow drift. The
    first and the last frame have no second difference and take that of their neighbour.
    """

    region: str

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", [self.region], regions.vertices)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        check_ordered("acceleration", comparison)
        vertices = comparison.regions.vertices[self.region]
        found, true, source = (
            acceleration(frames[:, vertices]) for frames in (comparison.retargeted, comparison.truth, comparison.source)
        )
        error = 100 * size(found - true) / _whole(true)
        yield Measurement("acceleration_error", self.region, "%", "lower", error)
        excess = (size(found) - size(true)) / _whole(source)
        yield Measurement("acceleration_excess", self.region, "1", "zero", excess)


def acceleration(frames: FloatArray) -> FloatArray:
    """(t, m, 3) mm per frame^2 of frames (t, m, 3) mm; zero for fewer than three."""
    if len(frames) < 3:
        return np.zeros_like(frames)
    inner = frames[2:] - 2 * frames[1:-1] + frames[:-2]
    return np.concatenate([inner[:1], inner, inner[-1:]])


def size(vectors: FloatArray) -> FloatArray:
    """(t,) root mean square length of vectors (t, m, 3)."""
    lengths: FloatArray = np.sqrt(np.einsum("tmi,tmi->t", vectors, vectors) / vectors.shape[1])
    return lengths


def _whole(vectors: FloatArray) -> float:
    return max(float(size(vectors).mean()), STILL)
