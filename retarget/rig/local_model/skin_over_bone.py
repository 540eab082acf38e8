"""How the skin of one character lies over its bone in known shapes: eqs (4) to (6) of Chandran et al. 2022.

A skin vertex is its bone point plus the thickness of the tissue along a normal. Bone points are the closest points of
the cranium, which does not move, so that they slide from shape to shape; the normal is the direction from there to the
skin, at right angles to a smooth bone. Known shapes are then met exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from retarget.anatomy.distance import Surface, closest
from retarget.anatomy.head import Head
from retarget.types import FloatArray, IntArray

THICKEST = 12.0  # mm of tissue through which bone constrains the skin
LOOSE = ("eyes", "lips", "ears", "interior")  # regions that hang over eyeballs, teeth and air
_NEARLY = 1e-3  # mm
_TOUCHING = 1e-6  # mm


@dataclass(frozen=True)
class SkinOverBone:
    """Bone points, normals and thicknesses of a skin vertices in K shapes, the neutral first."""

    vertices: IntArray  # (a,) sorted
    bone: FloatArray  # (K, a, 3) mm, b_v
    normals: FloatArray  # (K, a, 3), n_v
    thickness: FloatArray  # (K, a) mm, d_v

    @staticmethod
    def of(shapes: FloatArray, vertices: IntArray, bone: Surface) -> SkinOverBone:
        """Shapes (K, n, 3) mm of the skin, over a bone that does not move."""
        skin = shapes[:, vertices]
        below = np.repeat(closest(bone, skin[0])[None], len(skin), axis=0)
        moved = np.abs(skin - skin[0]).max(axis=2) > _TOUCHING  # the search is slow, and most skin there is still
        below[moved] = closest(bone, skin[moved])
        up = skin - below
        thickness = np.linalg.norm(up, axis=2)
        touching = thickness < _TOUCHING
        normals = up / np.where(touching, 1.0, thickness)[..., None]
        normals[touching] = normals[0][np.nonzero(touching)[1]]
        return SkinOverBone(vertices, below, normals, np.where(touching, 0.0, thickness))

    @property
    def stacked(self) -> FloatArray:
        """(K, 7, a): bone point, normal, thickness."""
        parts = [self.bone.transpose(0, 2, 1), self.normals.transpose(0, 2, 1), self.thickness[:, None]]
        return np.concatenate(parts, axis=1)


def cranial_bone(head: Head) -> Surface:
    """The triangles of the cranium, which expressions do not move."""
    faces = head.template.skull_faces
    cranial = np.isin(faces, head.template.cranium).all(axis=1)
    used, corners = np.unique(faces[cranial], return_inverse=True)
    return head.vertices[used], corners.reshape(-1, 3).astype(np.int64)


def vertices_over_cranium(head: Head) -> IntArray:
    """(a,) sorted vertices of the visible skin that lies over the cranium and no other bone: through tissue of at most
    `THICKEST`, and in none of the regions `LOOSE`."""
    regions = head.template.regions.vertices
    visible = regions.get("head", np.arange(len(head.skin)))
    for name in LOOSE:
        visible = np.setdiff1d(visible, regions.get(name, visible[:0]))
    points = head.skin[visible]
    to_cranium, to_skull = (
        np.linalg.norm(points - closest(bone, points), axis=1)
        for bone in (cranial_bone(head), (head.vertices, head.template.skull_faces))
    )
    over = (to_cranium <= THICKEST) & (to_cranium <= to_skull + _NEARLY)
    return np.sort(visible[over])
