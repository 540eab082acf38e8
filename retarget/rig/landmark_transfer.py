"""Landmark-guided deformation transfer (Onizuka et al. 2019), as a prefactored linear system.

Deformation transfer gets, besides the gradients Q_j of the source's triangles, places for 51 landmarks of the face. For
target vertices x and fourth vertices, with the gradients T_j that they make, it minimises

    w_data sum_j || T_j - Q_j ||^2  +  w_smooth sum_jk || (T_j - Q_j) - (T_k - Q_k) ||^2
        +  w_landmarks sum_l | x_l - c_l |^2  +  w_back sum_b | x_b - c_b |^2,

where j, k are triangles that share an edge, each pair counted from both sides as in Sumner and Popovic 2004, and b the
vertices of the cranium. The published terms are smoothness || T_j - T_k ||^2 and identity w_identity || T_j - 1 ||^2;
see `Regularity`.

A landmark of a part (right and left brow, nose, right and left eye, mouth) is put at

    c_l = T_l + F_T diag(r) F_S^T (S'_l - S_l)

with the frames F of the part on the two neutrals, and r the ratios of its extents along their axes. So lids travel
across the opening they have.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy.sparse as sp

from retarget.check import InvalidInput, check_faces, check_frames, check_triangle_areas, check_vertices
from retarget.geometry.cholesky import CholeskyFactor
from retarget.geometry.graph import components, half_edges, vertex_adjacency
from retarget.geometry.triangles import fourth_edges, gradient_operators
from retarget.suggest import choose
from retarget.types import FloatArray, IntArray, Pair, Regions

CHUNK = 8  # frames per solve
LANDMARKS = tuple(f"ibug_{i:02d}" for i in range(51))  # iBUG-68 without the jaw line


@dataclass(frozen=True)
class Part:
    """Landmarks that move by one rule, by their number in `LANDMARKS`."""

    name: str
    members: range
    plane: tuple[int, ...]  # those that the part's frame is fitted to


PARTS = (
    Part("right brow", range(0, 5), (0, 1, 2, 3, 4)),
    Part("left brow", range(5, 10), (5, 6, 7, 8, 9)),
    Part("nose", range(10, 19), (10, 14, 15, 16, 17, 18)),
    Part("right eye", range(19, 25), (19, 20, 21, 22, 23, 24)),
    Part("left eye", range(25, 31), (25, 26, 27, 28, 29, 30)),
    Part("mouth", range(31, 51), (33, 34, 35, 39, 40, 41, 44, 45, 46, 48, 49, 50)),
)
NOSE_TO_LIP = ((15, 44), (16, 45), (17, 46))  # their mean distance is the height of the mouth


class Regularity(StrEnum):
    """What is kept smooth."""

    # differs from the paper: what is added to the source's gradients, so that a face transfers to itself exactly
    CORRECTION = "correction"
    DEFORMATION = "deformation"  # the gradients themselves, which are also drawn to the identity: as published


@dataclass(frozen=True)
class LandmarkWeights:
    """data, smooth, identity: without unit; landmarks, back: in 1 / length_mm^2.

    The values are those of the authors' code, whose template head has 8,518 triangles and, as its size shows, is in
    millimetres. Raises InvalidInput for values out of range or an unknown regularity.
    """

    w_data: float = 1.0
    w_landmarks: float = 100.0
    w_smooth: float = 10.0
    w_identity: float = 1.0  # of the regularity `deformation` alone
    w_back: float = 1000.0
    regularity: Regularity | str = Regularity.CORRECTION
    length_mm: float = 1.0

    def __post_init__(self) -> None:
        for name in ("w_data", "w_landmarks", "w_back", "length_mm"):
            if not 0 < getattr(self, name) < np.inf:
                raise InvalidInput(f"{name}: expected a positive number, got {getattr(self, name)}.")
        for name in ("w_smooth", "w_identity"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InvalidInput(f"{name}: expected a number of at least 0, got {getattr(self, name)}.")
        choose("regularity", self.regularity, Regularity)


class LandmarkTransfer:
    """The transfer between a pair; raises InvalidInput as `DeformationTransfer` does, and for what `lacking` says."""

    def __init__(self, pair: Pair, weights: LandmarkWeights) -> None:
        source = check_vertices("source_neutral", pair.source_neutral)
        n = len(source)
        target = check_vertices("target_neutral", pair.target_neutral, n)
        faces = check_faces("faces", pair.faces, n)
        check_triangle_areas("source_neutral", source, faces)
        check_triangle_areas("target_neutral", target, faces)
        if reason := lacking(faces, n, pair.regions):
            raise InvalidInput(f"landmark-guided deformation transfer: {reason}.")
        self.source, self.target, self.faces = source, target, faces
        self._landmarks = np.array([pair.regions.landmarks[name] for name in LANDMARKS])
        self._back = pair.regions.vertices.get("cranium", np.empty(0, dtype=np.int64))
        self.size_ratio = float(np.linalg.norm(np.ptp(target, axis=0)) / np.linalg.norm(np.ptp(source, axis=0)))
        self._parts = part_maps(source[self._landmarks], target[self._landmarks], self.size_ratio)

        f = len(faces)
        self._source_fourth = fourth_edges(source, faces)
        self._source_gradient = sp.hstack(gradient_operators(source, faces), format="csr")
        own = sp.hstack(gradient_operators(target, faces), format="csr")  # of vertices and fourth edges
        smoothing = sp.kron(2 * weights.w_smooth * _dual_laplacian(faces), sp.eye_array(3), format="csr")
        identity = sp.eye_array(3 * f, format="csr")
        metric = weights.w_data * identity + smoothing
        follow = metric  # of T - Q
        if weights.regularity == Regularity.DEFORMATION:
            metric, follow = metric + weights.w_identity * identity, weights.w_data * identity
        self._w_landmarks, self._w_back = (w / weights.length_mm**2 for w in (weights.w_landmarks, weights.w_back))
        held = np.zeros(n + f)
        np.add.at(held, self._landmarks, self._w_landmarks)
        held[self._back] += self._w_back
        self._from_gradients = (own.T @ follow).tocsr()
        system = own.T @ metric @ own + sp.diags_array(held)
        self._factor = CholeskyFactor(system, "landmark-guided deformation transfer")

    def __call__(self, source_frames: FloatArray) -> FloatArray:
        """Target expressions (t, n, 3) mm for source expressions (t, n, 3) mm."""
        frames = check_frames("source_frames", source_frames, len(self.source))
        moved = np.empty_like(frames)
        for start in range(0, len(frames), CHUNK):
            part = slice(start, start + CHUNK)
            moved[part] = self._displacements(frames[part])
        return self.target + moved

    def wanted(self, source_frames: FloatArray) -> FloatArray:
        """c_l - T_l: displacements (t, 51, 3) mm of the landmarks."""
        moved = (source_frames - self.source)[:, self._landmarks]
        return np.einsum("lab,tlb->tla", self._parts, moved)

    def _displacements(self, frames: FloatArray) -> FloatArray:
        n, t = len(self.source), len(frames)
        by_vertex = np.ascontiguousarray(frames.transpose(1, 0, 2))  # (n, t, 3)
        moved = by_vertex - self.source[:, None]
        fourth = fourth_edges(by_vertex, self.faces) - self._source_fourth[:, None]
        gradients = self._source_gradient @ np.concatenate([moved, fourth]).reshape(-1, 3 * t)
        rhs = self._from_gradients @ gradients
        wanted = self.wanted(frames).transpose(1, 0, 2).reshape(-1, 3 * t)
        np.add.at(rhs, self._landmarks, self._w_landmarks * wanted)
        # differs from the paper: the back of the head moves as the source's does, times the ratio of sizes, not 0
        rhs[self._back] += self._w_back * self.size_ratio * moved[self._back].reshape(-1, 3 * t)
        solved: FloatArray = self._factor.solve(rhs)[:n].reshape(n, t, 3).transpose(1, 0, 2)
        return solved


def part_maps(source: FloatArray, target: FloatArray, size_ratio: float) -> FloatArray:
    """(51, 3, 3): F_T diag(r) F_S^T of each landmark's part, for landmarks (51, 3) mm on the two neutrals.

    Raises InvalidInput for a part that has no extent.
    """
    maps = np.empty((len(LANDMARKS), 3, 3))
    for part in PARTS:
        frames = [part_frame(points[list(part.plane)]) for points in (source, target)]
        before, after = (extent(points, part, axes) for points, axes in zip((source, target), frames, strict=True))
        if min(before.min(), after.min()) <= 1e-9 * max(before.max(), after.max()):
            raise InvalidInput(
                f"landmarks: those of the {part.name} have no extent along one of their axes ({before} mm on the "
                f"source, {after} mm on the target); expected distinct points."
            )
        ratio = after / before
        if part.name == "mouth":
            ratio[2] = size_ratio  # the authors force 1, after they have scaled one head to the other
        # differs from the paper: ratios act along the axes of the part, in which they were measured, not of the world
        maps[part.members] = frames[1] @ np.diag(ratio) @ frames[0].T
    return maps


def part_frame(points: FloatArray) -> FloatArray:
    """Axes (3, 3), as columns, of a part: the normal of the plane through points (m, 3) last, towards +z.

    The rotation turns about x, then about y, and never about z. That plane minimises the authors' sum over pairs.
    """
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    normal *= 1 if normal[2] >= 0 else -1
    across = np.array([normal[2], 0.0, -normal[0]])
    length = np.linalg.norm(across)
    across = across / length if length > 0 else np.array([1.0, 0.0, 0.0])
    return np.stack([across, np.cross(normal, across), normal], axis=-1)


def extent(points: FloatArray, part: Part, axes: FloatArray) -> FloatArray:
    """(3,) mm of a part along its axes, for all landmarks (51, 3) mm."""
    size = np.ptp(points[list(part.members)] @ axes, axis=0)
    if part.name == "mouth":
        size[1] = np.mean([np.linalg.norm(points[nose] - points[lip]) for nose, lip in NOSE_TO_LIP])
    return size


def lacking(faces: IntArray, vertex_count: int, regions: Regions) -> str | None:
    """What a topology lacks for this transfer, or None."""
    missing = [name for name in LANDMARKS if name not in regions.landmarks]
    if missing:
        return (
            f"{len(missing)} of the 51 landmarks ibug_00 to ibug_50 are unknown, the first is {missing[0]}; give this "
            "topology a regions file (docs/own_topology.md)"
        )
    held = np.zeros(vertex_count, dtype=bool)
    held[[regions.landmarks[name] for name in LANDMARKS]] = True
    held[regions.vertices.get("cranium", np.empty(0, dtype=np.int64))] = True
    loose = [piece for piece in components(vertex_adjacency(faces, vertex_count)) if not held[piece].any()]
    if loose:
        return (
            f"{len(loose)} connected pieces of the mesh hold neither a landmark nor a vertex of the region cranium, "
            f"the first is that of vertex {loose[0][0]}"
        )
    return None


def _dual_laplacian(faces: IntArray) -> sp.csr_array:
    """(f, f) graph Laplacian of the triangles, which are neighbours where they share an edge."""
    f = len(faces)
    edges = np.sort(half_edges(faces), axis=1)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    incidence = sp.csr_array((np.ones(3 * f), (np.tile(np.arange(f), 3), edge.ravel())))
    shared = (incidence @ incidence.T).tocsr()
    shared.setdiag(0)
    shared.eliminate_zeros()
    return sp.csr_array(sp.diags_array(shared.sum(axis=1)) - shared)
