"""Draws the pictures of docs/personal_expressions.md: `python docs/personal_figures.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from reports.bust import bust
from reports.camera import Camera, look
from reports.render import render_mesh
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head
from synth_data.personal.face import PersonalFace, personal_face
from synth_data.personal.scans import SCANS, personal_scans
from synth_data.personal.traits import draw_traits

IMAGES = Path(__file__).parent / "images"
SEEDS = (0, 1, 4, 5)
VIEWS = {"personal_expressions.png": 18.0, "personal_expressions_side.png": 80.0}  # degrees that the viewer walks round
SIZE, LABEL = (190, 225), 22
PER_ROW = len(SCANS) // 2


def faces_of(seeds: tuple[int, ...], steps: int = 1) -> list[PersonalFace]:
    """The people with these seeds on the mesh that is refined in `steps` steps."""
    head, targets = load_head(progress=print)
    regions = load_regions()
    fine = subdivide(head.faces, len(head.vertices), steps)
    people = [IdentitySampler(head, targets, regions)(seed) for seed in seeds]
    return [
        personal_face(fine(p.vertices), fine.faces, fine.regions(regions), draw_traits(p.seed, p.age)) for p in people
    ]


def camera(faces: list[PersonalFace], turn: float) -> Camera:
    """One view of all faces, from below the dropped chin to above the brows."""
    seen = []
    for face in faces:
        at = face.frame.local(face.neutral - face.frame.marks["pogonion"])
        top = face.frame.local(face.frame.marks["supraglabella"] - face.frame.marks["pogonion"])[1]
        seen.append(face.neutral[(at[:, 1] > -38) & (at[:, 1] < top + 22) & (at[:, 2] > -70)])
    return look(np.concatenate(seen), SIZE, turn=turn, raise_=2, margin=0.01)


def main() -> None:
    faces = faces_of(SEEDS)
    scans = [personal_scans(face) for face in faces]
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf", 13)
    for file, turn in VIEWS.items():
        view = camera(faces, turn)
        tall = LABEL + len(faces) * SIZE[1]
        sheet = Image.new("RGB", (PER_ROW * SIZE[0], 2 * tall), "white")
        draw = ImageDraw.Draw(sheet)
        for i, name in enumerate(SCANS):
            block, column = divmod(i, PER_ROW)
            place = ((column + 0.5) * SIZE[0], block * tall + LABEL / 2)
            draw.text(place, name.replace("_", " "), fill="#222222", anchor="mm", font=font)
            for row, (face, of_face) in enumerate(zip(faces, scans, strict=True)):
                picture = render_mesh(*bust(of_face[i].vertices, face.faces), view, SIZE)
                sheet.paste(Image.fromarray(picture), (column * SIZE[0], block * tall + LABEL + row * SIZE[1]))
        sheet.save(IMAGES / file, optimize=True)


if __name__ == "__main__":
    main()
