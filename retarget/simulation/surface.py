"""The hard form of the surface target: vertices of the tets that move with the skin (an option, never in anacon)."""

from __future__ import annotations

import numpy as np
import pyvista as pv
import scipy.sparse as sp
from trimesh.triangles import points_to_barycentric

from retarget.anatomy.boundary import boundary_faces
from retarget.anatomy.head import Head
from retarget.check import InvalidInput
from retarget.geometry.triangles import areas
from retarget.types import FloatArray, IntArray


def carried_by_skin(head: Head) -> tuple[IntArray, sp.csr_array]:
    """The outer vertices (q,) of the tets that carry skin, without the skull's, and Q (q, n) that moves them.

    Each goes with the point of the resting skin that is closest to it, by that point's barycentric weights: its
    displacement is that of ``Q @ (s - skin)``. Embedded skin hangs on several tet vertices, so prescribing these
    does not meet s exactly; a mesh whose surface vertices are skin vertices makes Q a selection and meets it.
    """
    template = head.template
    outer = np.setdiff1d(np.unique(boundary_faces(template.tets)[0]), template.skull)
    outer = np.intersect1d(outer, np.unique(template.embedding.indices))
    if len(outer) == 0:
        raise InvalidInput(
            "surface = hard: expected skin that hangs on outer vertices of the tets, found none; use surface = soft."
        )
    mesh = pv.PolyData.from_regular_faces(head.skin, template.faces)  # type: ignore[arg-type]  # its stub wants int
    cells, points = mesh.find_closest_cell(head.vertices[outer], return_closest_point=True)  # type: ignore[misc]
    triangles = template.faces[cells]
    weights = points_to_barycentric(head.skin[triangles], points)
    shape = len(outer), len(head.skin)
    return outer, sp.csr_array((weights.ravel(), (np.repeat(np.arange(len(outer)), 3), triangles.ravel())), shape=shape)


def vertex_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(n,) mm^2: a third of the triangles about each vertex."""
    third = np.repeat(areas(vertices, faces) / 3, 3)
    return np.asarray(np.bincount(faces.ravel(), third, len(vertices)), dtype=np.float64)
