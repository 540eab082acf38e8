"""Draws the picture of docs/truths.md: `python docs/truth_figures.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from reports.camera import look
from reports.colors import ERROR_COLORMAP
from reports.render import render_mesh
from synth_data.cache import ArrayCache
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import generic_rig, person_of
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head
from synth_data.personal.scans import unit_weights
from synth_data.truth import cast

IMAGE = Path(__file__).parent / "images" / "truths.png"
SEEDS = (0, 4, 5)
KINDS = ("nonlinear", "ebfr_arkit", "personal_blendshapes", "additive")
EXPRESSION = {"mouthSmile": 0.9, "jawOpen": 0.45, "cheekSquint": 0.5, "eyeSquint": 0.4, "browDown": 0.3}
SIZE, WORST = (260, 270), 8.0  # pixels; mm at the end of the colour bar


def main() -> None:
    head, targets = load_head(progress=print)
    regions = load_regions()
    fine = subdivide(head.faces, len(head.vertices), 1)
    generic, sampler = generic_rig(head, targets, regions), IdentitySampler(head, targets, regions)
    people = {str(seed): person_of(sampler(seed)) for seed in SEEDS}
    weights = unit_weights(EXPRESSION)[None]
    posed = {}
    for kind in KINDS:
        performers = cast(kind, generic, people, weights, ArrayCache.of(None), print)
        posed[kind] = [fine(performers[name](weights)[0]) for name in people]
    y, z = fine(head.vertices)[:, 1:].T
    shown = (y > 640) & (y < 790) & (z > 35)
    camera = look(np.concatenate([each[shown] for kind in KINDS for each in posed[kind]]), SIZE, turn=22, raise_=2)

    columns = len(KINDS) * 2 - 1
    figure, axes = plt.subplots(
        len(SEEDS), columns, figsize=(columns * 1.75, len(SEEDS) * 1.82 + 0.75), layout="constrained"
    )
    for row, of_person in zip(axes, range(len(SEEDS)), strict=True):
        truth = posed[KINDS[0]][of_person]
        for i, kind in enumerate(KINDS):
            row[i].imshow(render_mesh(posed[kind][of_person], fine.faces, camera, SIZE))
            if i:
                error = np.linalg.norm(posed[kind][of_person] - truth, axis=1)
                picture = render_mesh(posed[kind][of_person], fine.faces, camera, SIZE, error, limits=(0, WORST))
                row[len(KINDS) - 1 + i].imshow(picture)
    for i, kind in enumerate(KINDS):
        axes[0, i].set_title(kind, fontsize=9)
        if i:
            axes[0, len(KINDS) - 1 + i].set_title(f"{kind}\nagainst {KINDS[0]}", fontsize=9)
    for axis in axes.flat:
        axis.axis("off")
    scale = ScalarMappable(Normalize(0, WORST), ERROR_COLORMAP)
    bar = figure.colorbar(
        scale, ax=axes[-1, len(KINDS) :], location="bottom", extend="max", shrink=0.7, fraction=0.08, pad=0.02
    )
    bar.set_label("mm", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    figure.savefig(IMAGE, dpi=150)


if __name__ == "__main__":
    main()
