"""Soft-tissue depths: how far under the skin the skull lies (section 3.3 of the paper, where a model trained on CT
scans that is not open stands in their place).

``soft_tissue_depths.csv`` holds Rhine (1983), Southwestern Native American women, as tabulated by Rangel-de Lazaro
et al. (2026), Table 2, doi:10.4995/var.2024.24796. Studies differ by 2-4 mm at a landmark, hence tables are data.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from retarget.anatomy.distance import distance_to
from retarget.check import InvalidInput
from retarget.geometry.graph import components, vertex_adjacency
from retarget.geometry.laplacian import surface_energies
from retarget.types import FloatArray, IntArray, Regions

FILE = "soft_tissue_depths.csv"
LARGEST = 24.0  # mm; more than the published means (18 mm at most), so a larger number is another unit
STIFFNESS_LENGTH = 12.0  # mm over which the depth bends round a landmark


def load_depths(path: Path | None = None) -> dict[str, float]:
    """Depths in mm by landmark name; `path` names another table than the shipped one.

    A table has the columns ``landmark`` and ``depth_mm``; others are not read. A name without ``_left`` or ``_right``
    stands for the midline or for both sides. Raises InvalidInput for a table that is missing, lacks a column, names a
    landmark twice, or holds a depth outside (0, 24] mm.
    """
    try:
        text = (resources.files(__package__) / FILE if path is None else Path(path).expanduser()).read_text()
    except OSError as error:
        raise InvalidInput(f"depth table: expected a readable file, got {path} ({error.strerror}).") from error
    rows = csv.DictReader(text.splitlines())
    if not {"landmark", "depth_mm"} <= set(rows.fieldnames or ()):
        raise InvalidInput(f"depth table: expected the columns landmark and depth_mm, got {rows.fieldnames}.")
    depths: dict[str, float] = {}
    for row in rows:
        name = row["landmark"]
        try:
            depth = float(row["depth_mm"])
        except (TypeError, ValueError):
            depth = np.nan
        if not 0 < depth <= LARGEST:
            raise InvalidInput(
                f"depth table: expected a depth in (0, {LARGEST:g}] mm at {name}, got {row['depth_mm']!r}; "
                "correct that row."
            )
        if name in depths:
            raise InvalidInput(f"depth table: expected one row per landmark, got {name} twice; remove one.")
        depths[name] = depth
    return depths


def landmark_depths(depths: Mapping[str, float], regions: Regions) -> dict[str, float]:
    """Depths in mm by names of `regions.landmarks`, both sides of what is bilateral.

    Raises InvalidInput if a name of the table is no landmark of this topology, as such or on both sides.
    """
    found: dict[str, float] = {}
    for name, depth in depths.items():
        names = [name] if name in regions.landmarks else [f"{name}_left", f"{name}_right"]
        missing = [n for n in names if n not in regions.landmarks]
        if missing:
            raise InvalidInput(
                f"regions.landmarks: expected {name} (or {' and '.join(names)}), which carries a soft-tissue depth, "
                "got neither; add the landmark or leave its row out of the depth table."
            )
        found.update(dict.fromkeys(names, depth))
    return found


def depths_with_room(
    vertices: FloatArray, faces: IntArray, regions: Regions, depths: Mapping[str, float], behind: float = 0.0
) -> dict[str, float]:
    """The depths in mm of those landmarks whose bone lies before mouth and eye sockets of the skin (n, 3) mm, (f, 3).

    Where a cavity is nearer to a landmark than the bone and `behind` mm more, as behind the lips, the true bone (teeth
    and alveoli) lies inside the cavity of the mesh, so it is no part of this head and the landmark carries no depth.
    Raises InvalidInput for an unknown landmark, a depth outside (0, 24] mm, or if no landmark has room.
    """
    unknown = [name for name in depths if name not in regions.landmarks]
    if unknown:
        raise InvalidInput(
            f"depths: expected names of landmarks, got {unknown[0]!r}, which this topology has not; add the landmark "
            "or leave out its depth."
        )
    if not depths or not all(0 < depth <= LARGEST for depth in depths.values()):
        raise InvalidInput(
            f"depths: expected some, in (0, {LARGEST:g}] mm, got {sorted(depths.values()) or 'none'}; are they in mm?"
        )
    marks = vertices[[regions.landmarks[name] for name in depths]]
    room = distance_to((vertices, cavity_faces(faces, regions, len(vertices))), marks)
    kept = {name: depth for (name, depth), r in zip(depths.items(), room, strict=True) if r >= depth + behind}
    if not kept:
        raise InvalidInput(
            f"depths: expected room for bone before mouth and eye sockets, got none at any of {len(depths)} landmarks; "
            "are head and depths both in mm?"
        )
    return kept


def cavity_faces(faces: IntArray, regions: Regions, vertex_count: int) -> IntArray:
    """(g, 3) the triangles inside mouth and eye sockets."""
    interior = np.zeros(vertex_count, dtype=bool)
    interior[regions.vertices["interior"]] = True
    return faces[interior[faces].all(axis=1)]


def depth_basis(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> FloatArray:
    """(n, m) smooth functions on a surface, the j-th 1 at vertex landmarks[j] and 0 at the others; they sum to one.

    ``basis @ depths`` is the smoothest field with given depths (m,) at the landmarks: it minimises membrane plus
    thin-plate energy, integral |grad d|^2 + l^2 (Laplace d)^2 with l = `STIFFNESS_LENGTH`, so it bends smoothly round
    each landmark and stays near its neighbours' depths far from them. Raises InvalidInput if a part of the surface
    holds no landmark.
    """
    for part in components(vertex_adjacency(faces, len(vertices))):
        if not np.isin(landmarks, part).any():
            raise InvalidInput(
                f"skin: expected a landmark with a depth on each piece, got a piece of {len(part)} vertices without "
                f"one (vertex {part[0]}); remove what is not skin."
            )
    stiffness, mass = surface_energies(vertices, faces)
    energy = sp.csr_array(stiffness + STIFFNESS_LENGTH**2 * (stiffness @ sp.diags_array(1 / mass) @ stiffness))
    free = np.setdiff1d(np.arange(len(vertices)), landmarks)
    rows = energy[free]
    basis = np.zeros((len(vertices), len(landmarks)))
    basis[landmarks, np.arange(len(landmarks))] = 1.0
    factor = splu(sp.csc_matrix(rows[:, free]), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    basis[free] = factor.solve(-rows[:, landmarks].toarray())
    return basis
