"""Computes what ships for ICT-FaceKit's skin: ``regions.json`` and the head template.

    python -m synth_data.ict_facekit.author_data CLONE docs/examples/ict_facekit_landmarks.json

takes a few minutes. Regions are those of MakeHuman's head, transferred as docs/own_topology.md describes, from picked
landmarks; the lining of the nostrils, which are dimples there, counts as interior. The mesher does not repeat itself
bit by bit, so a rebuild makes another template of the same kind; what ships is the one that all results refer to.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.spatial import cKDTree

import retarget.anatomy
from retarget.anatomy.depths import depths_with_room, landmark_depths, load_depths
from retarget.anatomy.separate import separate
from retarget.anatomy.skin import isolate_skin
from retarget.anatomy.store import SHIPPED, build_stored, file_name, write_stored
from retarget.anatomy.transfer import transfer_regions
from retarget.io.landmarks import read_landmarks
from retarget.io.mesh import read_mesh
from retarget.io.regions import write_regions
from retarget.types import FloatArray, IntArray, Regions
from synth_data.ict_facekit.clone import find_clone
from synth_data.ict_facekit.nostrils import nostril_lining
from synth_data.ict_facekit.regions import FILE
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head
from synth_data.truth import FLIP

DECIMALS = 6  # of a mm, as meshes are written


def author_regions(mesh: Path, landmarks: Path) -> tuple[FloatArray, IntArray, Regions]:
    """The generic skin (n, 3) mm with its lips apart, its triangles, and its regions with the mirror."""
    unit, picked = read_landmarks(landmarks)
    vertices, faces = read_mesh(mesh)
    kept, faces = isolate_skin(faces, len(vertices), picked)
    skin = unit * vertices[kept]
    marks = {name: int(np.searchsorted(kept, vertex)) for name, vertex in picked.items()}
    base, _ = load_head()
    regions = transfer_regions((base.vertices, base.faces, load_regions()), skin, faces, marks)
    mirror = cKDTree(skin).query(skin * FLIP)[1]
    lining = nostril_lining(skin, faces, regions.vertices["nose"], mirror)
    sets = {name: np.setdiff1d(members, lining) for name, members in regions.vertices.items()}
    sets["interior"] = np.union1d(sets["interior"], lining)
    regions = replace(regions, vertices=sets, mirror=mirror)
    return np.round(separate(skin, faces, regions), DECIMALS), faces, regions


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m synth_data.ict_facekit.author_data")
    parser.add_argument("clone", type=Path)
    parser.add_argument("landmarks", type=Path)
    options = parser.parse_args()
    console = Console()
    skin, faces, regions = author_regions(find_clone(options.clone).neutral, options.landmarks)
    write_regions(Path(__file__).with_name(FILE), regions)
    skin = skin.astype(np.float32).astype(np.float64)  # as stored
    depths = depths_with_room(skin, faces, regions, landmark_depths(load_depths(), regions))
    with console.status("head template") as status:
        stored = build_stored(skin, faces, regions, depths, status.update)
    write_stored(Path(retarget.anatomy.__file__).with_name(SHIPPED) / file_name(faces), stored)
    console.print(f"{file_name(faces)}: {len(stored.tissue.vertices)} vertices, {len(stored.tissue.tets)} tets")


if __name__ == "__main__":
    main()
