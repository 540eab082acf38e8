"""Pictures of docs/anatomy.md: `python docs/anatomy_figures.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from reports.render import front, render_mesh, side, three_quarter, write_image
from retarget.anatomy.closed import cap
from retarget.anatomy.depths import landmark_depths, load_depths
from retarget.anatomy.skull import build_skull
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head

IMAGES = Path(__file__).parent / "images"
SIZE = (420, 560)
BONE = "#e3d9c3"


def main() -> None:
    base, targets = load_head()
    regions = load_regions()
    vertices, faces = cap("head", base.vertices + 0.3 * targets["units/jawOpen"], base.faces)
    skull = build_skull(vertices, faces, regions, landmark_depths(load_depths(), regions))
    cameras = [camera(vertices, SIZE) for camera in (front, three_quarter, side)]
    skin = [render_mesh(vertices, faces, camera, SIZE) for camera in cameras]
    bone = [render_mesh(skull.vertices, skull.faces, camera, SIZE, color=BONE) for camera in cameras]
    write_image(IMAGES / "anatomy_skull.png", np.vstack([np.hstack(skin), np.hstack(bone)]))


if __name__ == "__main__":
    main()
