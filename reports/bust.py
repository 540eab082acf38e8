"""A head for a picture, its neck cut straight where the mesh ends in a ragged rim."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from trimesh.intersections import slice_faces_plane

from retarget.geometry.edge_loops import boundary_loops
from retarget.types import FloatArray, IntArray

ABOVE = 1.0  # mm that the cut is above the rim's highest point
MOST = 0.2  # of the faces: a cut that takes more is through a face, whose rim runs all around it


def bust(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Vertices (m, 3) mm and faces (g, 3) above the plane through the longest open edge; a closed mesh stays whole.

    The plane is the one nearest to that edge, moved up until all of the edge is below it.
    """
    cut, triangles, _ = bust_with(vertices, faces, np.zeros(len(vertices)))
    return cut, triangles


def bust_with(vertices: FloatArray, faces: IntArray, values: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """`bust` with a value per vertex (n,), NaN allowed; a mesh stays whole where the cut takes more than `MOST`."""
    loops = _loops(np.ascontiguousarray(faces, dtype=np.int64).tobytes())
    if not loops:
        return vertices, faces, values
    rim = vertices[max(loops, key=lambda loop: float(np.linalg.norm(np.ptp(vertices[loop], axis=0))))]
    centre = rim.mean(axis=0)
    normal = np.linalg.svd(rim - centre)[2][-1]
    normal *= np.sign((vertices.mean(axis=0) - centre) @ normal)
    origin = centre + normal * (np.max((rim - centre) @ normal) + ABOVE)
    if np.mean(((vertices - origin) @ normal < 0)[faces].any(axis=1)) > MOST:
        return vertices, faces, values
    cut, triangles, kept = slice_faces_plane(vertices, faces, normal, origin, uv=np.column_stack([values, values]))
    return np.asarray(cut), np.asarray(triangles, dtype=np.int64), np.asarray(kept)[:, 0]


@lru_cache(maxsize=4)
def _loops(faces: bytes) -> tuple[IntArray, ...]:
    """The open edges of a mesh; many pictures show the same one."""
    return tuple(boundary_loops(np.frombuffer(faces, dtype=np.int64).reshape(-1, 3)))
