"""Builds the head template of the MakeHuman head and writes it where `retarget.anatomy.store` finds it.

    python -m synth_data.makehuman.author_template [wheel]

takes a few minutes. It is meshed in the neutral base head; the head subdivided once, the resolution of the default
data set, shares the tetrahedra and has its own embedding. The mesher does not repeat itself bit by bit, so a rebuild
makes another template of the same kind; what ships is the one that all results refer to.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

import retarget.anatomy
from retarget.anatomy.depths import depths_with_room, landmark_depths, load_depths
from retarget.anatomy.store import SHIPPED, Stored, build_stored, content_digest, file_name, write_stored
from retarget.anatomy.template import Progress
from retarget.types import FloatArray, IntArray, Regions
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head

Level = tuple[FloatArray, IntArray, Regions]  # skin (n, 3) mm as stored, faces (f, 3), regions


def levels(wheel: Path | None = None) -> list[Level]:
    """The neutral base head and its subdivision."""
    base, _ = load_head(wheel)
    step = subdivide(base.faces, len(base.vertices))
    regions = load_regions()
    skins = (base.vertices, step(base.vertices))
    coarse, fine = (skin.astype(np.float32).astype(np.float64) for skin in skins)
    return [(coarse, base.faces, regions), (fine, step.faces, step.regions(regions))]


def author_template(heads: list[Level], progress: Progress = lambda line: None) -> dict[str, Stored]:
    """What is stored for each of `levels`, by file name."""
    skin, faces, regions = heads[0]
    depths = depths_with_room(skin, faces, regions, landmark_depths(load_depths(), regions))
    made = build_stored(skin, faces, regions, depths, progress)
    return {file_name(f): replace(made, skin=v, content=content_digest(v, f, r, depths)) for v, f, r in heads}


def main() -> None:
    console = Console()
    with console.status("head template") as status:
        wheel = Path(sys.argv[1]) if len(sys.argv) > 1 else None
        made = author_template(levels(wheel), status.update)
    for name, stored in made.items():
        write_stored(Path(retarget.anatomy.__file__).with_name(SHIPPED) / name, stored)
        console.print(f"{name}: {len(stored.tissue.vertices)} vertices, {len(stored.tissue.tets)} tets")


if __name__ == "__main__":
    main()
