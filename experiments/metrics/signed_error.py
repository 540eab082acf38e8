"""Mean signed displacement error: a constant offset moves it fully, but moves a mean distance hardly at all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from experiments.metrics.metric import Comparison, Measurement, Metric, region_vertices


@dataclass(frozen=True)
class SignedError(Metric):
    """Mean over a region of retargeted - truth along each axis, in mm; zero is best."""

    regions: Sequence[str]

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        error = comparison.retargeted - comparison.truth
        for region, vertices in region_vertices(comparison.regions, self.regions):
            mean = error[:, vertices].mean(axis=1)
            for axis, name in enumerate("xyz"):
                yield Measurement(f"signed_error_{name}", region, "mm", "zero", mean[:, axis])
