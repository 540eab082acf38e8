"""What docs/data_sheet.md reports about the identities: `python -m synth_data.makehuman.anthropometry`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from retarget.types import FloatArray, IntArray
from synth_data.makehuman.identities import WIDTHS, IdentitySampler, measure
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import personal_rig
from synth_data.makehuman.targets import load_head


@dataclass(frozen=True)
class Comparison:
    """One distance of one gender, in mm: mean and standard deviation of the identities and as published."""

    distance: str
    gender: str
    mean: float
    deviation: float
    published_mean: float
    published_deviation: float


def compare_widths(sampler: IdentitySampler, landmarks: dict[str, int], seeds: Sequence[int]) -> list[Comparison]:
    """The four distances of the identities with these seeds against the published ones."""
    identities = [sampler(seed) for seed in seeds]
    rows = []
    for gender in ("man", "woman"):
        found = np.array([measure(i.vertices, landmarks) for i in identities if i.gender == gender])
        for name, mean, deviation in zip(WIDTHS, found.mean(axis=0), found.std(axis=0, ddof=1), strict=True):
            published = WIDTHS[name].men if gender == "man" else WIDTHS[name].women
            rows.append(Comparison(name, gender, float(mean), float(deviation), *published))
    return rows


def personalisation(a: FloatArray, b: FloatArray, region: IntArray) -> float:
    """How much two rigs (51, n, 3) differ, as a share of their motion over the vertices of a region.

    RMS over units and vertices of |a - b|, divided by the RMS of |a| and |b| taken together: 0 for equal rigs,
    1.41 for unrelated ones.
    """
    a, b = a[:, region], b[:, region]
    return float(np.sqrt(np.sum((a - b) ** 2) / (0.5 * np.sum(a**2) + 0.5 * np.sum(b**2))))


def main() -> None:
    head, targets = load_head(progress=print)
    regions = load_regions()
    sampler = IdentitySampler(head, targets, regions)
    print("\n| distance | gender | identities (mm) | published (mm) |\n| --- | --- | --- | --- |")
    for row in compare_widths(sampler, dict(regions.landmarks), range(60)):
        print(
            f"| {row.distance} | {row.gender} | {row.mean:.1f} ± {row.deviation:.1f} | "
            f"{row.published_mean:.1f} ± {row.published_deviation:.1f} |"
        )
    rigs = [personal_rig(sampler(seed), head, targets, regions) for seed in range(12)]
    everywhere = [personalisation(a, b, regions.vertices["head"]) for a, b in itertools.combinations(rigs, 2)]
    tenth, ninetieth = np.quantile(everywhere, [0.1, 0.9])
    print(
        f"\nPersonal deltas of two identities differ by {np.mean(everywhere):.0%} of the motion (mean of "
        f"{len(everywhere)} pairs, 80 % of them between {tenth:.0%} and {ninetieth:.0%}; region head)."
    )


if __name__ == "__main__":
    main()
