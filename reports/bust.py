"""A head for a picture, its neck cut straight where the mesh ends in a ragged rim."""

from __future__ import annotations

import numpy as np
from trimesh.intersections import slice_faces_plane

from retarget.geometry.edge_loops import boundary_loops
from retarget.types import FloatArray, IntArray

ABOVE = 1.0  # mm that the cut is above the rim's highest point


def bust(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Vertices (m, 3) mm and faces (g, 3) above the plane through the longest open edge; a closed mesh stays whole.

    The plane is the one nearest to that edge, moved up until all of the edge is below it.
    """
    loops = boundary_loops(faces)
    if not loops:
        return vertices, faces
    rim = vertices[max(loops, key=lambda loop: float(np.linalg.norm(np.ptp(vertices[loop], axis=0))))]
    centre = rim.mean(axis=0)
    normal = np.linalg.svd(rim - centre)[2][-1]
    normal *= np.sign((vertices.mean(axis=0) - centre) @ normal)
    origin = centre + normal * (np.max((rim - centre) @ normal) + ABOVE)
    cut, triangles, _ = slice_faces_plane(vertices, faces, normal, origin)
    return np.asarray(cut), np.asarray(triangles, dtype=np.int64)
