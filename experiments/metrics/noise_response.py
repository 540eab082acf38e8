"""What noise of the source does to the result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.metrics.acceleration import size
from experiments.metrics.metric import Comparison, Measurement, Metric, check_ordered, lacking
from retarget.types import FloatArray, Regions


@dataclass(frozen=True)
class NoiseResponse(Metric):
    """Root mean square change of the result over that of the source, where the source has noise; without unit.

    1 passes noise on as it is, more amplifies it. One number for the whole animation, the same at every frame. A
    method that ignores the source scores 0: read it beside the error. It needs a study that adds noise.
    """

    region: str

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", [self.region], regions.vertices)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        check_ordered("noise_response", comparison)
        response = 0.0
        if (disturbed := comparison.disturbed) is not None:
            vertices = comparison.regions.vertices[self.region]
            change = disturbed.retargeted - comparison.retargeted[: len(disturbed.noise)]
            response = _overall(change[:, vertices]) / _overall(disturbed.noise[:, vertices])
        yield Measurement("noise_response", self.region, "1", "lower", np.full(len(comparison.retargeted), response))


def _overall(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(size(vectors) ** 2)))
