"""How deep lips lie in each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.lip_depth import LipDepth
from experiments.metrics.metric import Comparison, Measurement, Metric, lacking
from retarget.types import Regions


@dataclass(frozen=True)
class LipPenetration(Metric):
    """Depth in mm of the deepest visible vertex of one lip in the other, beyond the neutral's; see `LipDepth`.

    The corners of the mouth are left out, and so are crossings between vertices: an edge of one lip through a triangle
    of the other shows in `self_intersections`. No truth enters: linear truths cross too (the reference row `truth`
    says how much).
    """

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("vertices", ["upper_lip", "lower_lip"], regions.vertices) or lacking(
            "landmarks", ["cheilion_left", "cheilion_right"], regions.landmarks
        )

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        depth = LipDepth(comparison.target_neutral, comparison.faces, comparison.regions)
        deepest = np.array([depth(frame).max(initial=0.0) for frame in comparison.retargeted])
        yield Measurement("lip_depth", "lips", "mm", "lower", deepest)
