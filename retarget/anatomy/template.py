"""The head template (section 3.3): tetrahedra of soft and muscle tissue between a neutral skin and its skull.

The paper's template is not open; here one is built from a surface with regions and landmarks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from retarget.anatomy.bones import label_bones
from retarget.anatomy.boundary import boundary_faces, enclosed_volume, signed_volumes
from retarget.anatomy.closed import cap, check_closed
from retarget.anatomy.depths import depths_with_room, landmark_depths, load_depths
from retarget.anatomy.distance import Surface, distance_to
from retarget.anatomy.embedding import embed
from retarget.anatomy.head import HeadTemplate
from retarget.anatomy.mesher import tetrahedralise
from retarget.anatomy.muscle import muscle_tets
from retarget.anatomy.sizing import FINE_LOOPS, sizing_field
from retarget.anatomy.skull import build_skull, check_parts
from retarget.anatomy.tissue import Tissue, refine
from retarget.check import InvalidInput, check_faces, check_vertices
from retarget.geometry.graph import half_edges
from retarget.simulation.tetrahedra import rest_shape
from retarget.types import FloatArray, IntArray, Regions

REFINEMENTS = {"coarse": 0, "paper": 1}  # steps of refinement by the name of a size
ENVELOPE = 0.4  # mm between the tets' boundary and the surfaces
QUALITY = 10.0  # AMIPS energy at which the mesher stops; 3 is the regular tet
SKULL_TRIANGLES = 16_000  # handed to the mesher, which makes its own
NEEDED = {  # beyond what the skull needs
    "vertices": ("face", "cranium", "cranium_skin", "jaw_skin"),  # the last three for the simulation
    "loops": FINE_LOOPS,
    "landmarks": ("cheilion_left", "cheilion_right"),
    "points": ("condyle_left", "condyle_right"),
}
SMALLEST_HEAD, LARGEST_HEAD = 150.0, 800.0  # mm, diagonal of the bounding box, neck and bust included
_LOST = 0.01  # share of the volume between skin and skull that the tets may miss

Progress = Callable[[str], object]


def build_template(
    surface: FloatArray,
    faces: IntArray,
    regions: Regions,
    depths: Mapping[str, float] | None = None,
    size: str = "coarse",
    progress: Progress = lambda line: None,
) -> HeadTemplate:
    """The template of a topology, meshed in the neutral surface (n, 3) mm with triangles (f, 3), neck open.

    `depths` in mm by landmark, by default the shipped table. Takes about two minutes; `load_template` finds what was
    built before. Raises InvalidInput for a surface that is open elsewhere, crosses itself or holds NaN, for a region
    or landmark that is missing, and for depths that leave no room for a skull under the skin.
    """
    check_size(size)
    skin = check_vertices("surface", surface)
    faces = check_faces("faces", faces, len(skin))
    check_regions(regions)
    check_unit(skin)
    depths = landmark_depths(load_depths(), regions) if depths is None else depths
    depths = depths_with_room(skin, faces, regions, depths)
    tissue = resize(build_tissue(skin, faces, regions, depths, progress), size)
    progress("labelling muscle")
    return assemble(skin, faces, regions, depths, tissue, muscle_tets(skin, faces, regions, tissue))


def build_tissue(
    skin: FloatArray, faces: IntArray, regions: Regions, depths: Mapping[str, float], progress: Progress
) -> Tissue:
    """Tets of the coarse size between the capped skin (n, 3) mm and the skull at `depths`; see `build_template`."""
    check_regions(regions)
    progress("checking the surface")
    capped = cap("surface", skin, faces)
    check_closed("surface", *capped)
    progress("building the skull")
    bone = build_skull(*capped, regions, depths)
    skull = _thinned(bone.vertices, bone.faces)
    progress("sizing the tetrahedra")
    sizing = sizing_field(capped, skull, regions)
    both = np.vstack([capped[0], skull[0]]), np.vstack([capped[1], skull[1][:, ::-1] + len(capped[0])])
    vertices, tets = tetrahedralise(*both, sizing, ENVELOPE, QUALITY, progress)
    rest_shape(vertices, tets)  # refuses flat tets
    wanted, found = enclosed_volume(*capped) - enclosed_volume(*skull), signed_volumes(vertices, tets).sum()
    if abs(found - wanted) > _LOST * wanted:
        raise InvalidInput(
            f"tetrahedra: expected {wanted / 1e3:.0f} cm^3 between skin and skull, got {found / 1e3:.0f}; the surfaces "
            "cross or lie too close."
        )
    skull_faces = _skull_side(vertices, tets, capped, skull)
    return Tissue(vertices, tets, skull_faces)


def resize(tissue: Tissue, size: str) -> Tissue:
    """The coarse tissue in a size of `REFINEMENTS`."""
    for _ in range(REFINEMENTS[size]):
        tissue = refine(tissue)
    return tissue


def assemble(
    skin: FloatArray,
    faces: IntArray,
    regions: Regions,
    depths: Mapping[str, float],
    tissue: Tissue,
    muscle: NDArray[np.bool_],
) -> HeadTemplate:
    """The template of tissue of which `muscle` (t,) says what is muscle: bones labelled, skin embedded."""
    check_regions(regions)
    cranium, jaw = label_bones(skin, regions, tissue.vertices, np.unique(tissue.skull_faces))
    return HeadTemplate(
        skin=skin,
        faces=faces,
        regions=regions,
        vertices=tissue.vertices,
        tets=tissue.tets,
        muscle=muscle,
        embedding=embed(skin, faces, tissue.vertices, tissue.tets),
        skull_faces=tissue.skull_faces,
        cranium=cranium,
        jaw=jaw,
        depths=depths,
    )


def check_size(size: str) -> None:
    """Raises InvalidInput for a name that is none of the sizes."""
    if size not in REFINEMENTS:
        raise InvalidInput(f"size: expected one of {', '.join(REFINEMENTS)}, got {size!r}.")


def check_unit(skin: FloatArray) -> None:
    """Raises InvalidInput if a head (n, 3) is not as large as heads are in mm."""
    size = float(np.linalg.norm(np.ptp(skin, axis=0)))
    if not SMALLEST_HEAD < size < LARGEST_HEAD:
        raise InvalidInput(
            f"surface: expected a head of {SMALLEST_HEAD:g} to {LARGEST_HEAD:g} mm from corner to corner, got "
            f"{size:.3g}; vertices are in mm."
        )


def check_regions(regions: Regions) -> None:
    """Raises InvalidInput if a part that the template is built from is missing."""
    check_parts(regions)
    missing = [f"{part}[{n!r}]" for part, names in NEEDED.items() for n in names if n not in getattr(regions, part)]
    if missing:
        raise InvalidInput(
            f"regions: expected what the head template needs, {', '.join(missing)} missing; docs/regions.md says what "
            "each name means. Add it to the topology's regions."
        )


def _thinned(vertices: FloatArray, faces: IntArray) -> Surface:
    """The skull with fewer triangles, so that the mesher starts from fewer needles."""
    mesh = pv.PolyData.from_regular_faces(vertices, faces)  # type: ignore[arg-type]  # its stub wants int
    mesh = mesh.decimate(max(0.0, 1 - SKULL_TRIANGLES / mesh.n_cells))
    return np.asarray(mesh.points, dtype=np.float64), np.asarray(mesh.regular_faces, dtype=np.int64)


def _skull_side(vertices: FloatArray, tets: IntArray, skin: Surface, skull: Surface) -> IntArray:
    """Boundary triangles (g, 3) nearer to the skull than to the skin, facing out of the bone."""
    triangles, _ = boundary_faces(tets)
    centres = vertices[triangles].mean(axis=1)
    to_skin, to_skull = (distance_to(s, centres) for s in (skin, skull))
    faces: IntArray = triangles[to_skull < to_skin][:, ::-1]
    edges = np.sort(half_edges(faces), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    if len(faces) == 0 or (uses % 2).any():
        raise InvalidInput(
            f"skull: expected a closed boundary of the tets, got {int((uses % 2).sum())} open edges among {len(faces)} "
            "triangles; the skull touches the skin; check the landmarks and the depths."
        )
    return faces
