"""The picture of docs/artistic_control.md: `python docs/artistic_figures.py`, the edits of `study=artistic`."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageChops

from experiments.artistic import ArtisticStudy, edited, scene
from experiments.catalogue import MethodMaker, composed
from reports.artistic_sheet import write_artistic_sheet
from synth_data.makehuman.dataset import MakeHuman

IMAGES = Path(__file__).parent / "images"
MARGIN = 12  # pixels


def main() -> None:
    settings = dict(composed("run", ["study=artistic", "study.expression=sparse-049"]).study)
    settings.pop("kind")
    study = ArtisticStudy.from_config(settings)
    people = MakeHuman(identities=2, subdivisions=1, truth="personal_blendshapes", weights="sparse").load()
    panels = edited(study, scene(study, MethodMaker.of("anacondar"), people))
    for panel in panels:
        print(panel.title, {k: v if isinstance(v, str) else round(float(v), 4) for k, v in panel.numbers.items()})
    path = IMAGES / "artistic_control.png"
    with tempfile.TemporaryDirectory() as work:
        write_artistic_sheet(path, study.title, study.description, panels, Path(work))
    page = Image.open(path).convert("RGB")
    _, top, _, bottom = ImageChops.invert(page).getbbox() or (0, 0, *page.size)
    rows = np.flatnonzero((np.asarray(page) < 250).any(axis=(1, 2)))
    foot = rows[rows < rows[-1] - 20].max()  # above the page number
    page.crop((0, max(top - MARGIN, 0), page.width, min(foot, bottom) + MARGIN)).save(path)


if __name__ == "__main__":
    main()
