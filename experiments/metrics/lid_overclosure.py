"""How far the upper lid passes the lower one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking
from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class LidOverclosure(Metric):
    """Depth in mm by which the upper lid margin lies below the lower one, at its deepest; of each eye, and of both.

    `eye_aperture` takes such an eye for open. Measured between the corners of the eye, along the opening of the
    target's neutral. No truth enters: a shut eye that should be open scores 0, and a truth that over-closes scores
    more than 0 (the reference row `truth` says how much).
    """

    sides: Sequence[str]  # left, right: of the loops lid_margin_* and the landmarks endocanthion_* and exocanthion_*

    def unsupported(self, regions: Regions) -> str | None:
        corners = [f"{corner}canthion_{side}" for side in self.sides for corner in ("endo", "exo")]
        return lacking("loops", [f"lid_margin_{side}" for side in self.sides], regions.loops) or lacking(
            "landmarks", corners, regions.landmarks
        )

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        neutral, regions, depths = comparison.target_neutral, comparison.regions, []
        for side in self.sides:
            corners = [regions.landmarks[f"{corner}canthion_{side}"] for corner in ("endo", "exo")]
            upper, lower = lids(neutral, regions.loops[f"lid_margin_{side}"], corners)
            depths.append(overclosure(neutral, comparison.retargeted, upper, lower))
            yield Measurement("lid_overclosure", f"eye_{side}", "mm", "lower", depths[-1])
        yield Measurement("lid_overclosure", "eyes", "mm", "lower", np.max(depths, axis=0))


def lids(neutral: FloatArray, margin: IntArray, corners: Sequence[int]) -> tuple[IntArray, IntArray]:
    """(upper, lower): the two ways along a loop between the vertices nearest to two corners, these included."""
    start, end = (int(np.argmin(np.linalg.norm(neutral[margin] - neutral[corner], axis=1))) for corner in corners)
    loop = np.roll(margin, -start)
    there = (end - start) % len(margin)
    ways = loop[: there + 1], np.r_[loop[:1], loop[there:][::-1]]
    upper, lower = sorted(ways, key=lambda way: -neutral[way, 1].mean())
    return upper, lower


def overclosure(neutral: FloatArray, frames: FloatArray, upper: IntArray, lower: IntArray) -> FloatArray:
    """(t,) mm of frames (t, n, 3) mm: the most that any vertex of the upper lid lies below the lower one."""
    along = neutral[upper[-1]] - neutral[upper[0]]
    along /= np.linalg.norm(along)
    up = neutral[upper].mean(axis=0) - neutral[lower].mean(axis=0)
    up -= (up @ along) * along
    up /= np.linalg.norm(up)
    depths = np.zeros(len(frames))
    for i, frame in enumerate(frames):
        place, floor = frame[lower] @ along, frame[lower] @ up
        order = np.argsort(place, kind="stable")
        below = np.interp(frame[upper] @ along, place[order], floor[order]) - frame[upper] @ up
        depths[i] = max(below[1:-1].max(initial=0.0), 0.0)
    return depths
