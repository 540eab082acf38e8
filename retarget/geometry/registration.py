"""Non-rigid registration of one triangle mesh to another, from a few corresponding landmarks.

Similarity alignment, a thin-plate warp through the landmarks, then closest points on the other surface and in turn
displacements that bend little (the bilaplacian), stiff at first and softer in each round. As in Amberg et al. (2007)
the stiffness falls; here it acts on displacements, which has no rotation to solve for and is one factorisation a round.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import RBFInterpolator

from retarget.geometry.cholesky import CholeskyFactor
from retarget.geometry.graph import vertex_adjacency
from retarget.geometry.oriented import OrientedSurface, vertex_normals
from retarget.geometry.procrustes import similarity_align
from retarget.types import FloatArray, IntArray

STIFFNESS = np.geomspace(300.0, 0.3, 24)  # of bending against closeness, one for each round
FACING = 0.5  # cosine of the angle beyond which a closest point is not the right one
FAR = 12.0  # mm beyond which it is not either
LANDMARK = 30.0  # weight of a landmark against a vertex


def register(
    moving: FloatArray,
    moving_faces: IntArray,
    followed: IntArray,
    fixed: FloatArray,
    fixed_faces: IntArray,
    landmarks: tuple[IntArray, IntArray],
) -> FloatArray:
    """Vertices (n, 3) mm of `moving` where they lie on `fixed` (m, 3) mm.

    `followed` are the vertices of `moving` that look for the other surface; the others are carried along, such as the
    mouth cavity. `landmarks` are the vertices (k,) of `moving` and of `fixed` that correspond.
    """
    ours, theirs = landmarks
    scale, rotation, translation = similarity_align(moving[ours], fixed[theirs])
    aligned = scale * moving @ rotation.T + translation
    warp = RBFInterpolator(aligned[ours], fixed[theirs] - aligned[ours], kernel="thin_plate_spline", smoothing=1.0)
    start = aligned + warp(aligned)

    n = len(moving)
    adjacency = vertex_adjacency(moving_faces, n)
    degree = np.asarray(adjacency.sum(axis=1)).ravel()
    laplacian = sp.csr_array(sp.eye_array(n) - sp.diags_array(1.0 / np.maximum(degree, 1.0)) @ adjacency)
    bending = sp.csr_array(laplacian.T @ laplacian)
    pull = np.zeros(n)
    pull[ours] = LANDMARK
    goal = np.zeros((n, 3))
    np.add.at(goal, ours, fixed[theirs])
    goal[ours] /= np.bincount(ours, minlength=n)[ours][:, None]

    surface = OrientedSurface(fixed, fixed_faces)
    now = start
    for stiffness in STIFFNESS:
        normals = vertex_normals(now, moving_faces)
        sample = surface.closest(now[followed], normals[followed])
        there, facing = surface.positions[sample], surface.normals[sample]
        gap = np.einsum("ij,ij->i", there - now[followed], facing)
        near = np.linalg.norm(there - now[followed], axis=1) < FAR
        right = np.einsum("ij,ij->i", facing, normals[followed]) > FACING
        weight = np.zeros(n)
        weight[followed] = near & right
        target = now.copy()
        target[followed] += gap[:, None] * facing  # free to slide along the surface
        total = weight + pull
        system = sp.csc_array(sp.diags_array(total + 1e-6) + stiffness * bending)
        rhs = weight[:, None] * (target - start) + pull[:, None] * (goal - start)
        now = start + CholeskyFactor(system, "registration").solve(rhs)
    return now
