"""Draws the pictures of docs/data_sheet.md: `python docs/data_figures.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from reports.bust import bust
from reports.camera import Camera, look
from reports.render import render_mesh
from retarget.types import FloatArray, IntArray
from synth_data.cache import ArrayCache
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import generic_rig, person_of
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head
from synth_data.personal.scans import unit_weights
from synth_data.truth import cast
from synth_data.weights import blending_weights

IMAGES = Path(__file__).parent / "images"
COLUMNS, LABEL = 8, 26  # pictures in a row, pixels of the label above each
TRUTH, EXPRESSIONS = "ebfr_arkit", 250  # the defaults of dataset.truth and dataset.expressions
UNITS = (
    (), ("jawOpen",), ("jawOpen", "mouthClose"), ("mouthSmile",), ("mouthPucker",), ("cheekPuff",), ("eyeBlink",),
    ("browDown",),
)  # fmt: skip


def sheet(
    path: Path, heads: list[FloatArray], faces: IntArray, labels: list[str], camera: Camera, size: tuple[int, int]
) -> None:
    """Write rows of rendered heads, the labels above the first ones or all of them."""
    rows = -(-len(heads) // COLUMNS)
    labelled = -(-len(labels) // COLUMNS)
    out = Image.new("RGB", (COLUMNS * size[0], rows * size[1] + labelled * LABEL), "white")
    draw = ImageDraw.Draw(out)
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf", 17)
    for i, head in enumerate(heads):
        row, column = divmod(i, COLUMNS)
        top = row * size[1] + min(row + 1, labelled) * LABEL
        out.paste(Image.fromarray(render_mesh(*bust(head, faces), camera, size)), (column * size[0], top))
        if i < len(labels):
            draw.text(((column + 0.5) * size[0], top - LABEL / 2), labels[i], fill="#222222", anchor="mm", font=font)
    out.save(path, optimize=True)


def main() -> None:
    head, targets = load_head(progress=print)
    regions = load_regions()
    sampler = IdentitySampler(head, targets, regions)
    fine = subdivide(head.faces, len(head.vertices), 1)
    y, z = fine(head.vertices)[:, 1:].T
    above_neck, face = y > 600, (y > 608) & (y < 785) & (z > 35)

    people = [sampler(seed) for seed in range(24)]
    heads = [fine(person.vertices) for person in people]
    size = (230, 290)
    camera = look(np.stack(heads)[:, above_neck], size, turn=28, raise_=3, margin=0.01)
    labels = [f"{person.seed}: {person.gender}, {person.age:.0f}" for person in people]
    sheet(IMAGES / "data_identities.png", heads, fine.faces, labels, camera, size)

    size = (230, 260)
    units = np.stack([unit_weights(dict.fromkeys(names, 1.0)) for names in UNITS])
    titles = [", ".join(names) or "neutral" for names in UNITS]
    rows = np.arange(COLUMNS) * (EXPRESSIONS // COLUMNS)
    blended = blending_weights("recombined", EXPRESSIONS)[rows]
    shown = {
        "data_units.png": (units, titles),
        "data_expressions.png": (blended, [f"recombined-{i:03d}" for i in rows]),
    }
    camera = look(np.stack(heads[:4])[:, face], size, turn=22, raise_=2, margin=0.01)
    cast_of = {str(person.seed): person_of(person) for person in people[:4]}
    performers = cast(TRUTH, generic_rig(head, targets, regions), cast_of, units, ArrayCache.of(None), print)
    for file, (weights, above) in shown.items():
        posed = [fine(frame) for name in cast_of for frame in performers[name](weights)]
        sheet(IMAGES / file, posed, fine.faces, above, camera, size)


if __name__ == "__main__":
    main()
