"""Templates by topology: shipped with the package for MakeHuman's head, built once and kept for any other.

Stored is what the mesher made, the coarse tissue, with the skin it was made for and the digest of all that entered;
sizes, labels and embedding follow from it and from the regions in seconds, and are the same bits everywhere.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from retarget.anatomy.depths import depths_with_room, landmark_depths, load_depths
from retarget.anatomy.head import HeadTemplate
from retarget.anatomy.muscle import muscle_tets
from retarget.anatomy.template import (
    REFINEMENTS,
    Progress,
    assemble,
    build_tissue,
    check_regions,
    check_size,
    check_unit,
    resize,
)
from retarget.anatomy.tissue import Tissue
from retarget.check import InvalidInput, check_faces, check_vertices
from retarget.io.files import cache_folder, write_whole
from retarget.types import FloatArray, IntArray, Regions

FORMAT = 1  # raise it when the construction or the arrays change
SHIPPED = "templates"  # folder of the package


@dataclass(frozen=True)
class Stored:
    """All of a template that takes long."""

    skin: FloatArray  # (n, 3) mm
    tissue: Tissue  # coarse
    muscle: Mapping[str, NDArray[np.bool_]]  # by size, (t,) of its tets
    depths: Mapping[str, float]  # mm by landmark
    content: str  # digest of surface, faces, regions, depths and FORMAT


def load_template(faces: IntArray, regions: Regions, size: str = "coarse", cache: Path | None = None) -> HeadTemplate:
    """The template of a topology, triangles (f, 3), in one of the sizes ``coarse`` and ``paper``; takes seconds.

    Raises InvalidInput if none is shipped for it or was stored in the `cache` folder by `store_template`.
    """
    check_size(size)
    name = file_name(faces)
    stored = shipped(name) or read_stored(cache_folder(cache) / name)
    if stored is None:
        raise InvalidInput(
            f"template: none is known for this topology of {len(faces)} triangles. Build it once (about two minutes): "
            "python -m retarget.anatomy build MESH REGIONS"
        )
    tissue = resize(stored.tissue, size)
    return assemble(stored.skin, faces, regions, stored.depths, tissue, stored.muscle[size])


def store_template(
    surface: FloatArray,
    faces: IntArray,
    regions: Regions,
    depths: Mapping[str, float] | None = None,
    cache: Path | None = None,
    progress: Progress = lambda line: None,
) -> Path:
    """Build the template of a topology in the neutral surface (n, 3) mm, unless it is there, and return its file.

    What is there is used if surface, faces, regions and depths are those it was built from. Raises InvalidInput as
    `build_template` does, and if the folder cannot be written.
    """
    skin = check_vertices("surface", surface).astype(np.float32).astype(np.float64)  # as stored
    faces = check_faces("faces", faces, len(skin))
    check_regions(regions)
    check_unit(skin)
    depths = landmark_depths(load_depths(), regions) if depths is None else depths
    depths = depths_with_room(skin, faces, regions, depths)
    path = cache_folder(cache) / file_name(faces)
    known = read_stored(path)
    if known is None or known.content != content_digest(skin, faces, regions, depths):
        write_stored(path, build_stored(skin, faces, regions, depths, progress))
    return path


def build_stored(
    skin: FloatArray, faces: IntArray, regions: Regions, depths: Mapping[str, float], progress: Progress
) -> Stored:
    """What takes long, for a skin (n, 3) mm in single precision and `depths` with room; see `build_template`."""
    tissue = rounded(build_tissue(skin, faces, regions, depths, progress))
    progress("labelling muscle")
    muscle = {size: muscle_tets(skin, faces, regions, resize(tissue, size)) for size in REFINEMENTS}
    return Stored(skin, tissue, muscle, depths, content_digest(skin, faces, regions, depths))


def rounded(tissue: Tissue) -> Tissue:
    """With vertices in single precision, as they are stored."""
    return replace(tissue, vertices=tissue.vertices.astype(np.float32).astype(np.float64))


def content_digest(skin: FloatArray, faces: IntArray, regions: Regions, depths: Mapping[str, float]) -> str:
    """Digest of all that a template is built from."""
    found = hashlib.sha256(f"format {FORMAT}".encode())
    for array in (skin.astype(np.float32), faces.astype(np.int64)):
        found.update(np.ascontiguousarray(array).tobytes())
    for part in (regions.vertices, regions.loops):
        for name in sorted(part):
            found.update(name.encode() + np.asarray(part[name], dtype=np.int64).tobytes())
    for name, point in sorted(regions.points.items()):
        found.update(name.encode() + np.asarray(point(skin), dtype=np.float32).tobytes())
    found.update(repr((sorted(regions.landmarks.items()), sorted(depths.items()))).encode())
    return found.hexdigest()


def write_stored(path: Path, stored: Stored) -> None:
    """To a compressed .npz, whole or not at all."""
    tissue = stored.tissue
    arrays = {
        "skin": stored.skin.astype(np.float32),
        "vertices": tissue.vertices.astype(np.float32),
        "tets": tissue.tets.astype(np.int32),
        "skull_faces": tissue.skull_faces.astype(np.int32),
        "landmarks": np.array(list(stored.depths)),
        "depths": np.array(list(stored.depths.values())),
        "content": np.array(stored.content),
    } | {f"muscle_{size}": np.packbits(muscle) for size, muscle in stored.muscle.items()}
    write_whole(path, lambda temporary: np.savez_compressed(temporary, **arrays))  # type: ignore[arg-type]


def shipped(name: str) -> Stored | None:
    """What the package holds under a file name, or None."""
    with resources.as_file(resources.files(__package__) / SHIPPED / name) as path:
        return read_stored(path)


def read_stored(path: Path) -> Stored | None:
    """What is stored, or None where nothing whole is."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            tets = stored["tets"].astype(np.int64)
            tissue = Tissue(
                vertices=stored["vertices"].astype(np.float64),
                tets=tets,
                skull_faces=stored["skull_faces"].astype(np.int64),
            )
            depths = dict(zip(stored["landmarks"].tolist(), stored["depths"].tolist(), strict=True))
            muscle = {
                size: np.unpackbits(stored[f"muscle_{size}"], count=len(tets) * 8**steps).astype(bool)
                for size, steps in REFINEMENTS.items()
            }
            return Stored(stored["skin"].astype(np.float64), tissue, muscle, depths, str(stored["content"]))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def file_name(faces: IntArray) -> str:
    """Name of the file for a topology."""
    digest = hashlib.sha256(np.ascontiguousarray(faces, dtype=np.int64).tobytes()).hexdigest()
    return f"head-{digest[:16]}-{FORMAT}.npz"
