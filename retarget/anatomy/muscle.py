"""The layer of muscle on the facial skeleton."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from retarget.anatomy.boundary import boundary_faces
from retarget.anatomy.distance import distance_to
from retarget.anatomy.tissue import Tissue
from retarget.geometry.graph import components, vertex_adjacency
from retarget.types import FloatArray, IntArray, Regions

SHARE = 0.4  # of the way from the outer skin to bone or mouth at which muscle begins
DEEPEST = 20.0  # mm under the outer skin; the palate lies behind bone
SOFT = ("ears", "eyes", "lips")  # no muscle under these
NOSE_TIP = 0.8  # of the distance from the nose's tip to the end of its bones: no muscle nearer to the tip


def muscle_tets(skin: FloatArray, faces: IntArray, regions: Regions, tissue: Tissue) -> NDArray[np.bool_]:
    """(t,) whether a tet is muscle: its centroid lies deeper than `SHARE` of the way from the outer skin inward.

    Inward of it lie the skull and the mouth. Muscle lies under the region ``face`` alone, not over the vault, not in
    ears, lids, lips and nose tip or about the orbits, and nowhere at the surface, which is soft tissue.
    """
    centroids = tissue.vertices[tissue.tets].mean(axis=1)
    mouth = np.zeros(len(skin), dtype=bool)
    mouth[_mouth_cavity(faces, regions, len(skin))] = True
    to_skin = distance_to((skin, faces[~mouth[faces].any(axis=1)]), centroids)
    to_inner = distance_to((tissue.vertices, tissue.skull_faces), centroids)
    if mouth.any():
        to_inner = np.minimum(to_inner, distance_to((skin, faces[mouth[faces].all(axis=1)]), centroids))
    covered = np.zeros(len(skin), dtype=bool)
    covered[regions.vertices["face"]] = True
    for name in SOFT:
        covered[regions.vertices[name]] = False
    rhinion, tip = (skin[regions.landmarks[name]] for name in ("rhinion", "pronasale"))
    covered[np.linalg.norm(skin - tip, axis=1) < NOSE_TIP * np.linalg.norm(rhinion - tip)] = False
    _, nearest = cKDTree(skin[~mouth]).query(centroids)
    deep = (to_skin > SHARE * (to_skin + to_inner)) & (to_skin < DEEPEST)
    muscle: NDArray[np.bool_] = covered[~mouth][nearest] & deep
    triangles, owner = boundary_faces(tissue.tets)
    muscle[owner[~np.isin(triangles, tissue.skull_faces).all(axis=1)]] = False
    return muscle


def _mouth_cavity(faces: IntArray, regions: Regions, count: int) -> IntArray:
    """The vertices of the region ``interior`` that are connected to the lips within it; the others are orbits."""
    interior, lips = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    interior[regions.vertices["interior"]] = True
    lips[regions.vertices["lips"]] = True
    adjacency = vertex_adjacency(faces[interior[faces].any(axis=1)], count)
    inside = np.flatnonzero(interior)
    touching = adjacency @ lips > 0
    parts = [inside[part] for part in components(adjacency[inside][:, inside])]
    found = [part for part in parts if touching[part].any()]
    return np.concatenate(found) if found else np.zeros(0, dtype=np.int64)
