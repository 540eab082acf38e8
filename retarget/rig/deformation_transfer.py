"""Deformation transfer between two characters in one topology, as a prefactored linear system.

Sumner and Popovic 2004 ask for target vertices x, and a fourth vertex x4 for each triangle, that minimise

    sum_j w_j || Q_j - [x2 - x1, x3 - x1, x4 - x1] V_j^-1 ||_F^2

where Q_j is the deformation gradient of source triangle j and V_j the rest frame of target triangle j.

The fourth vertices drop out. The third column of V_j is normal to the triangle, so the first two rows of V_j^-1, the
gradients g2 and g3 of hat functions, lie in its plane, and the third is along its unit normal n. With P = I - n n^T
the term splits into orthogonal parts:

    || Q_j P - (x2 - x1) g2^T - (x3 - x1) g3^T ||^2  +  || Q_j n - (x4 - x1) / |v4 - v1| ||^2.

x4 occurs in this one term alone and makes the second part zero. What remains is a Poisson system over the n vertices,
with the whole 3x3 gradient of the source on the right (P tilts it into the target's plane, which brings in the
source's normal):

    (G_T^T W G_T) x = G_T^T W [Q_1^T; Q_2^T; ...].

With w_j = 1 this is the form of 2004 exactly, and with w_j = the area of the target triangle the gradient transfer of
Botsch, Sumner, Pauly and Gross 2006, "Deformation transfer for detail-preserving surface editing", who noted that
the two differ in the weights alone. Since [Q_j^T] = G_S y + N_S nu(y) for source vertices y (see
`retarget.geometry.triangles.gradient_operators`), the right-hand side is two sparse matrices, made once, that act on
the source's displacements and on the change of its fourth edges nu.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
import scipy.sparse as sp
from numba import njit

from retarget.check import InvalidInput, check_faces, check_frames, check_triangle_areas, check_vertices
from retarget.geometry.cholesky import CholeskyFactor
from retarget.geometry.graph import components, vertex_adjacency
from retarget.geometry.triangles import areas, fourth_edges, gradient_operators
from retarget.types import FloatArray, IntArray, Pair

CHUNK = 8  # frames per solve: fastest where measured (4 to 8), and bounds the memory
STILL = 0.05  # share of a component's vertices that serve as its anchors where none are given


class Weighting(StrEnum):
    """Weight of a triangle in the sum."""

    UNIFORM = "uniform"  # Sumner and Popovic 2004
    AREA = "area"  # Botsch et al. 2006


class DeformationTransfer:
    """dt(source expression, source neutral, target neutral) for many expressions.

    source, target   (n, 3) neutrals in mm
    faces            (f, 3)
    anchors          vertices that fix the translation, for example the cranium; may be empty

    The energy leaves each connected component free to translate. One of its vertices is pinned for the solve, then
    the component is moved so that on average its anchors are displaced as in the source, times the ratio of the
    bounding boxes' diagonals. This makes the transfer to itself and to a scaled copy exact, whatever the anchors do.
    A component without anchors uses those of its vertices that move least in the expression at hand.

    Raises InvalidInput for meshes that do not fit together, degenerate triangles, and anchors outside of the mesh.
    """

    def __init__(
        self,
        source: FloatArray,
        target: FloatArray,
        faces: IntArray,
        anchors: IntArray,
        weighting: Weighting | str = Weighting.UNIFORM,
    ) -> None:
        source = check_vertices("source_neutral", source)
        n = len(source)
        target = check_vertices("target_neutral", target, n)
        faces = check_faces("faces", faces, n)
        check_triangle_areas("source_neutral", source, faces)
        check_triangle_areas("target_neutral", target, faces)
        anchors = np.asarray(anchors, dtype=np.int64)
        if len(anchors) and not 0 <= anchors.min() <= anchors.max() < n:
            raise InvalidInput(
                f"anchors: expected vertex indices from 0 to {n - 1}, got {anchors.min()} to {anchors.max()}; "
                "the region belongs to another topology."
            )

        self.source, self.target, self.faces = source, target, faces
        self.size_ratio = float(np.linalg.norm(np.ptp(target, axis=0)) / np.linalg.norm(np.ptp(source, axis=0)))
        self._source_fourth = fourth_edges(source, faces)
        self._components = components(vertex_adjacency(faces, n))
        self._anchors = [np.intersect1d(piece, anchors) for piece in self._components]

        weight = areas(target, faces) if Weighting(weighting) is Weighting.AREA else np.ones(len(faces))
        target_gradient, _ = gradient_operators(target, faces)
        source_gradient, source_normal = gradient_operators(source, faces)
        divergence = (target_gradient.T @ sp.diags_array(np.repeat(weight, 3))).tocsr()
        pinned = np.array([piece[0] for piece in self._components])
        self._free = np.setdiff1d(np.arange(n), pinned)
        self._from_displacements = (divergence @ source_gradient).tocsr()[self._free]
        self._from_fourth = (divergence @ source_normal).tocsr()[self._free]
        self._divergence = divergence[self._free]
        laplacian = (divergence @ target_gradient).tocsr()
        self._factor = CholeskyFactor(laplacian[self._free][:, self._free], "deformation transfer")

    @classmethod
    def of(cls, pair: Pair, weighting: Weighting | str) -> DeformationTransfer:
        """The transfer between a pair, anchored on its region ``cranium`` where the topology names one."""
        anchors = pair.regions.vertices.get("cranium", np.empty(0, dtype=np.int64))
        return cls(pair.source_neutral, pair.target_neutral, pair.faces, anchors, weighting)

    def __call__(self, source_frames: FloatArray) -> FloatArray:
        """Target expressions (t, n, 3) in mm for source expressions (t, n, 3) in mm."""
        return self.target + self.displacements(source_frames)

    def displacements(self, source_frames: FloatArray) -> FloatArray:
        """dt(source_frames) - target neutral: (t, n, 3) in mm."""
        source_frames = check_frames("source_frames", source_frames, len(self.source))
        moved = np.empty_like(source_frames)
        for start in range(0, len(source_frames), CHUNK):
            part = slice(start, start + CHUNK)
            moved[part] = self._displacements(source_frames[part])
        return moved

    def integrate(self, changes: FloatArray, source_moved: FloatArray) -> FloatArray:
        """Displacements (t, n, 3) mm of the target whose gradients come closest to changes (t, f, 3, 3), without unit.

        changes[i, j] is a transposed gradient, as in `gradient_operators`. source_moved (t, n, 3) mm are the source's
        displacements: what stands still in them is not translated. `displacements` plus this is thus the transfer with
        the source's gradients changed.
        """
        n, t = len(self.source), len(changes)
        rhs = self._divergence @ changes.transpose(1, 2, 0, 3).reshape(-1, 3 * t)
        moved = np.zeros((n, t, 3))
        moved[self._free] = self._factor.solve(rhs).reshape(-1, t, 3)
        self._translate(moved, np.zeros_like(moved), source_moved.transpose(1, 0, 2))
        return moved.transpose(1, 0, 2)

    def at(self, vertices: IntArray) -> PointTransfer:
        """The transfer of a few of its vertices (k,) alone, in less time."""
        return PointTransfer(self, vertices)

    def _displacements(self, frames: FloatArray) -> FloatArray:
        n, t = len(self.source), len(frames)
        by_vertex = np.ascontiguousarray(frames.transpose(1, 0, 2))  # (n, t, 3)
        source_moved = by_vertex - self.source[:, None]
        fourth_moved = fourth_edges(by_vertex, self.faces) - self._source_fourth[:, None]
        rhs = self._right_side(source_moved.reshape(n, -1), fourth_moved.reshape(len(self.faces), -1))
        target_moved = np.zeros_like(source_moved)
        target_moved[self._free] = self._factor.solve(rhs).reshape(-1, t, 3)
        self._translate(target_moved, self.size_ratio * source_moved, source_moved)
        return target_moved.transpose(1, 0, 2)

    def _right_side(self, moved: FloatArray, fourth_moved: FloatArray) -> FloatArray:
        """(m, c) at the free vertices, of displacements (n, c) mm and changes of fourth edges (f, c)."""
        rhs: FloatArray = self._from_displacements @ moved
        rhs += self._from_fourth @ fourth_moved
        return rhs

    def _translate(self, moved: FloatArray, wanted: FloatArray, source_moved: FloatArray) -> None:
        """Shift each component of moved (n, t, 3) so that its anchors have the mean displacement of `wanted`."""
        for piece, anchors in zip(self._components, self._anchors, strict=True):
            if len(anchors):
                moved[piece] += (wanted[anchors] - moved[anchors]).mean(axis=0)
                continue
            still = _stillest(np.linalg.norm(source_moved[piece], axis=-1))[..., None]  # (m, t, 1)
            moved[piece] += np.sum(still * (wanted[piece] - moved[piece]), axis=0) / still.sum(axis=0)


class PointTransfer:
    """Rows of the solution operator of a deformation transfer: the same result at a few vertices, without the solve.

    The transfer is linear in its right-hand side, the final translation included, so each vertex has a row over the
    free vertices: one solve with the adjoint, once. Where a component has no anchors, what it stands on depends on the
    expression and the whole transfer is solved.
    """

    def __init__(self, transfer: DeformationTransfer, vertices: IntArray) -> None:
        """vertices: (k,) of the transfer's mesh."""
        self.transfer, self.vertices = transfer, np.asarray(vertices, dtype=np.int64)
        owner = np.full(len(transfer.source), -1)
        for number, piece in enumerate(transfer._components):
            owner[piece] = number
        owner = owner[self.vertices]
        self._anchored = all(len(transfer._anchors[number]) for number in np.unique(owner))
        if not self._anchored:
            return
        of_anchors = sp.csr_array(
            np.vstack([np.bincount(a, minlength=len(transfer.source)) / max(len(a), 1) for a in transfer._anchors])
        )
        self._standing = sp.csr_array(of_anchors[owner])  # (k, n): the mean of the anchors
        picked = sp.eye_array(len(transfer.source), format="csr")[self.vertices] - self._standing
        self._rows = np.ascontiguousarray(transfer._factor.solve(picked[:, transfer._free].toarray().T).T)  # (k, m)

    def __call__(self, expression: FloatArray) -> FloatArray:
        """Target positions (k, 3) mm of the vertices for one source expression (n, 3) mm."""
        transfer = self.transfer
        if not self._anchored:
            return transfer(expression[None])[0][self.vertices]
        moved, fourth = expression - transfer.source, np.empty_like(transfer._source_fourth)
        _fourth_moved(np.ascontiguousarray(expression), transfer.faces, transfer._source_fourth, fourth)
        there: FloatArray = transfer.target[self.vertices] + self._rows @ transfer._right_side(moved, fourth)
        there += transfer.size_ratio * (self._standing @ moved)
        return there


@njit(cache=True)
def _fourth_moved(x, faces, before, moved):  # type: ignore[no-untyped-def]
    """`fourth_edges` less those before, in one pass."""
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        u0, u1, u2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        v0, v1, v2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        scale = 1 / np.sqrt(length) if length > 0 else 1.0
        moved[f, 0] = n0 * scale - before[f, 0]
        moved[f, 1] = n1 * scale - before[f, 1]
        moved[f, 2] = n2 * scale - before[f, 2]


def _stillest(motion: FloatArray) -> FloatArray:
    """(m, t) mask with ones for the 5 % of the m vertices that move least in each frame, and for all that tie."""
    count = max(1, round(STILL * len(motion)))
    return np.where(motion <= np.partition(motion, count - 1, axis=0)[count - 1], 1.0, 0.0)
