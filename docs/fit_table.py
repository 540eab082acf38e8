"""The table of docs/anatomy.md, "Fit to a character": `python docs/fit_table.py [coarse|paper] [identities]`."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import numpy as np

from retarget.anatomy.fit import fit_with_report
from retarget.anatomy.store import load_template
from retarget.anatomy.untangle import volume_ratios
from retarget.check import InvalidInput
from retarget.simulation.tetrahedra import rest_shape
from retarget.types import FloatArray
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import Targets, load_head

MACRO = {
    "old man": ("caucasian-male-old", "universal-male-old-minmuscle-averageweight"),
    "fat woman": ("african-female-young", "universal-female-young-averagemuscle-maxweight"),
    "thin old woman": ("asian-female-old", "universal-female-old-minmuscle-minweight"),
    "heavy man": ("african-male-young", "universal-male-young-maxmuscle-maxweight"),
}
COLUMNS = (
    "tets inverted, flat, left flat",
    "volume ratio: least, 1 %",
    "skin residual, mm: 50 %, 95 %, max",
    "worst depth, mm, at landmarks",
    "skull under skin, mm",
    "CPU s",
)
EXAGGERATED = (0, 1, 2, 3)  # seeds shown again at 1.5 and 2 times their distance from the mean


def characters(head: BaseHead, targets: Targets, count: int) -> Iterator[tuple[str, FloatArray]]:
    """Names and base-resolution skins (n, 3) mm: sampled, exaggerated and those at the ends of the macro targets."""
    sampler = IdentitySampler(head, targets, load_regions())
    sampled = [sampler(seed).vertices for seed in range(count)]
    yield from ((f"seed {seed}", vertices) for seed, vertices in enumerate(sampled))
    mean = np.mean(sampled, axis=0)
    for factor in (1.5, 2.0):
        for seed in EXAGGERATED[:count]:
            yield f"seed {seed} x {factor:g}", mean + factor * (sampled[seed] - mean)
    for name, parts in MACRO.items():
        yield name, head.vertices + sum(targets[f"macrodetails/{part}"] for part in parts)
    yield "small, 0.85", 0.85 * head.vertices
    yield "large, 1.15", 1.15 * head.vertices


def main(size: str = "coarse", count: int = 20) -> None:
    head, targets = load_head()
    division = subdivide(head.faces, len(head.vertices))
    regions = division.regions(load_regions())
    template = load_template(division.faces, regions, size)
    rest = rest_shape(template.vertices, template.tets)
    print(f"| character | {' | '.join(COLUMNS)} |\n| --- |" + " ---: |" * len(COLUMNS))
    for name, vertices in characters(head, targets, count):
        start = time.process_time()
        try:
            fitted, report = fit_with_report(template, division(vertices))
        except InvalidInput as error:
            print(f"| {name} | refused: {error} |")
            continue
        seconds = time.process_time() - start
        ratios = volume_ratios(rest, fitted.vertices)
        residual = np.linalg.norm(fitted.residual[regions.vertices["head"]], axis=1)
        worst = max(map(abs, fitted.depth_errors.values()))
        row = (
            f"{report.repair.inverted}, {report.repair.before}, {report.repair.after}",
            f"{ratios.min():.2f}, {np.percentile(ratios, 1):.2f}",
            f"{np.median(residual):.2f}, {np.percentile(residual, 95):.2f}, {residual.max():.1f}",
            f"{worst:.2f} at {len(fitted.depth_errors)} of {len(template.depths)}",
            f"{report.skull.clearance:.2f}",
            f"{seconds:.1f}",
        )
        print(f"| {name} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:2], *map(int, sys.argv[2:3]))
