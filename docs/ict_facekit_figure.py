"""Draws docs/images/ict_facekit.png: `python docs/ict_facekit_figure.py CLONE`."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from reports.camera import look
from reports.render import render_mesh
from synth_data.ict_facekit.dataset import IctFaceKit
from synth_data.personal.face import personal_face
from synth_data.personal.scans import SCANS, unit_weights

IMAGE = Path(__file__).parent / "images" / "ict_facekit.png"
SHOWN = ("smile", "jaw_drop", "eyes_shut", "pucker", "sadness")
VIEWS = (15.0, 75.0)  # degrees that the viewer walks round
SIZE, LABEL = (190, 225), 22
NECK = -160.0  # mm, the end of what is drawn


def main() -> None:
    troupe = IctFaceKit(root=sys.argv[1]).troupe(print)
    weights = np.stack([np.zeros(51), *(unit_weights(SCANS[name]) for name in SHOWN)])
    people = [personal_face(p.neutral, troupe.faces, troupe.regions, p.traits)(weights) for p in troupe.people.values()]
    rests = np.concatenate([frames[0] for frames in people])
    seen = rests[(rests[:, 1] > -135) & (rests[:, 1] < 75) & (rests[:, 2] > 10)]
    names = ("at rest", *SHOWN)
    sheet = Image.new("RGB", (len(VIEWS) * len(names) * SIZE[0], LABEL + len(people) * SIZE[1]), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf", 13)
    for column, (turn, frame) in enumerate((turn, frame) for turn in VIEWS for frame in range(len(names))):
        view = look(seen, SIZE, turn=turn, raise_=2, margin=0.01)
        place = ((column + 0.5) * SIZE[0], LABEL / 2)
        draw.text(place, names[frame].replace("_", " "), fill="#222222", anchor="mm", font=font)
        for row, frames in enumerate(people):
            drawn = troupe.faces[(frames[0][:, 1] > NECK)[troupe.faces].all(axis=1)]
            picture = render_mesh(frames[frame], drawn, view, SIZE)
            sheet.paste(Image.fromarray(picture), (column * SIZE[0], LABEL + row * SIZE[1]))
    sheet.save(IMAGE, optimize=True)


if __name__ == "__main__":
    main()
