"""Draws the pictures of docs/data_sheet.md: `python docs/data_figures.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from reports.camera import Camera, look
from reports.render import render_mesh
from retarget.types import FloatArray, IntArray
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import personal_rig
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head
from synth_data.sequence import sparse_weights

IMAGES = Path(__file__).parent / "images"
COLUMNS, LABEL = 8, 26  # pictures in a row, pixels of the label above each
UNITS = (
    (), ("jawOpen",), ("jawOpen", "mouthClose"), ("mouthSmileLeft", "mouthSmileRight"), ("mouthPucker",),
    ("cheekPuff",), ("eyeBlinkLeft", "eyeBlinkRight"), ("browDownLeft", "browDownRight"),
)  # fmt: skip
TITLES = ("neutral", "jawOpen", "jawOpen, mouthClose", "mouthSmile", "mouthPucker", "cheekPuff", "eyeBlink", "browDown")


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
        out.paste(Image.fromarray(render_mesh(head, faces, camera, size)), (column * size[0], top))
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
    faces = fine.faces[above_neck[fine.faces].all(axis=1)]

    people = [sampler(seed) for seed in range(24)]
    heads = [fine(person.vertices) for person in people]
    size = (230, 290)
    camera = look(np.stack(heads)[:, above_neck], size, turn=28, raise_=3, margin=0.01)
    labels = [f"{person.seed}: {person.gender}, {person.age:.0f}" for person in people]
    sheet(IMAGES / "data_identities.png", heads, faces, labels, camera, size)

    size = (230, 260)
    rigs = [personal_rig(person, head, targets, regions) for person in people[:4]]
    units = np.array([[float(name in active) for name in SKIN_NAMES] for active in UNITS])
    rows = {"data_units.png": (units, list(TITLES)), "data_expressions.png": (sparse_weights(8), [])}
    camera = look(np.stack(heads[:4])[:, face], size, turn=22, raise_=2, margin=0.01)
    for file, (weights, titles) in rows.items():
        posed = [
            fine(person.vertices + np.tensordot(w, rig, axes=1))
            for person, rig in zip(people, rigs, strict=False)
            for w in weights
        ]
        sheet(IMAGES / file, posed, faces, titles or [f"sparse-{i:03d}" for i in range(8)], camera, size)


if __name__ == "__main__":
    main()
