"""The skull of a face: the surface that lies as deep under the skin as the published depths say.

The skin without ears, lips and nose tip is bridged smoothly where these were; the skull is the level set of
(distance to that skin - depth), kept off eye sockets and mouth cavity and cut off from the neck.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyvista as pv
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from retarget.anatomy.depths import depth_basis, depths_with_room
from retarget.anatomy.distance import distance_to, signed_distance
from retarget.check import InvalidInput
from retarget.geometry.graph import components, vertex_adjacency
from retarget.types import FloatArray, IntArray, Regions

NEEDED_SETS = ("head", "interior", "ears", "lips", "nose", "eyes", "neck")
NEEDED_LANDMARKS = ("rhinion", "pronasale", "menton", "gonion_left", "gonion_right", "tragion_left", "tragion_right")
NAMED = 3  # of the parts that are missing, in an error
CLEARANCE = 1.0  # mm of soft tissue between bone and any skin
CAVITY_CLEARANCE = 3.0  # mm of soft tissue between bone and the skin of eye sockets and mouth
ROUNDING = 3.0  # mm over which the lower edges of mandible and occiput and the orbits' edges are rounded
TOLERANCE = 0.2  # mm that the depth at a landmark may be off; the fit to a face promises 1 mm
_SPACING = 2.0  # mm between the samples of the skin
_REACH = 30.0  # mm that the skin is looked for from a point; no depth comes near it
_CORRECTION = 6.0  # mm that the depths at the landmarks may be corrected by
_SMALLEST_PIECE = 2000.0  # mm^3; the jaw may be a piece of its own
_SHELL = 1.25  # grid steps about the skin in which a point's side is that of the nearest point beyond
_ROUNDS = 6  # of correcting the depths at the landmarks


@dataclass(frozen=True)
class Skull:
    """A closed surface of one or several pieces, and how far its depths are off the table's, by landmark in mm."""

    vertices: FloatArray  # (n, 3) mm
    faces: IntArray  # (f, 3), outward
    errors: Mapping[str, float]


def build_skull(
    vertices: FloatArray, faces: IntArray, regions: Regions, depths: Mapping[str, float], spacing: float = 2.0
) -> Skull:
    """The skull under a capped head (n, 3) mm, (f, 3); `depths` in mm by landmark, `spacing` of the grid in mm.

    The field is corrected until the distance from each landmark to the skull is the depth of the table; landmarks
    without room (`depths_with_room`) are left out. Cranium and jaw may be separate pieces, and the jaw may be an arch
    with its ramus on the cranium, so the Euler number is free. Raises InvalidInput if a region or landmark is missing,
    if a depth lies outside (0, 24] mm, or if the level set is not closed or not under the skin.
    """
    check_parts(regions)
    bridged = bridge_skin(vertices, faces, regions)
    depths = depths_with_room(vertices, faces, regions, depths)
    names = list(depths)
    marks = np.array([regions.landmarks[name] for name in names])
    wanted = np.array([depths[name] for name in names])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    grid = _Grid.between(np.array([low[0], vertices[marks, 1].min(), low[2]]), high, spacing)  # no bone below the chin
    samples, weights = _sample(bridged, faces)
    tree = cKDTree(samples, leafsize=64)
    basis = depth_basis(vertices, faces, marks)
    shallow = wanted.min() / 2
    signed, nearest = grid.signed_distance(tree, weights @ np.maximum(basis @ wanted, shallow))
    base = _base_limit(vertices, regions, grid.points)
    limit = _cavity_limit(vertices, faces, regions, grid)
    for centre, radius in zip(vertices[marks], wanted, strict=True):
        ball = grid.box(centre - 2 * radius, centre + 2 * radius)
        limit[ball] = np.minimum(limit[ball], np.linalg.norm(grid.points[ball] - centre, axis=1) - radius)
    given = wanted.copy()
    for _ in range(_ROUNDS):
        field = weights @ np.maximum(basis @ given, shallow)
        inner = _smooth_minimum(_smooth_minimum(signed - field[nearest], base, ROUNDING), limit, ROUNDING)
        surface = _level_set(inner, limit, grid)
        found = distance_to(surface, vertices[marks])
        if np.abs(found - wanted).max() < TOLERANCE:
            break
        given = np.clip(given + wanted - found, wanted - _CORRECTION, wanted + _CORRECTION)
    depth = signed_distance((vertices, faces), surface[0])
    if depth.min() < 0:
        raise InvalidInput(
            f"skull: expected room for it under the skin, got {int((depth < 0).sum())} of its {len(depth)} vertices "
            f"outside, the farthest by {-depth.min():.1f} mm near {np.round(surface[0][depth.argmin()], 1).tolist()} "
            "mm; the depths do not fit this head there, or its skin is not closed."
        )
    return Skull(*surface, dict(zip(names, (found - wanted).tolist(), strict=True)))


@dataclass(frozen=True)
class _Grid:
    """A regular grid."""

    low: FloatArray  # (3,) mm
    spacing: float  # mm
    shape: tuple[int, ...]
    points: FloatArray  # (g, 3) mm

    @staticmethod
    def between(low: FloatArray, high: FloatArray, spacing: float) -> _Grid:
        margin = 3 * spacing  # the air about the head is one piece
        low, high = low - margin, high + margin
        shape = tuple(int(s) for s in np.ceil((high - low) / spacing).astype(int) + 1)
        points = low + spacing * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
        return _Grid(low, spacing, shape, points)

    def box(self, low: FloatArray, high: FloatArray) -> IntArray:
        """Indices of the points between two corners."""
        first, last = (np.clip(np.ceil((c - self.low) / self.spacing).astype(int), 0, self.shape) for c in (low, high))
        return np.ravel_multi_index(np.ix_(*map(np.arange, first, last)), self.shape).ravel()

    def signed_distance(self, tree: cKDTree, field: FloatArray) -> tuple[FloatArray, IntArray]:
        """(g,) mm from the points of a closed surface, positive inside, and (g,) the nearest of its points.

        Exact about the depths `field` at its points and for a few grid steps outside; elsewhere only the side counts.
        """
        reach = 4 * self.spacing
        distance, nearest = tree.query(self.points, distance_upper_bound=_SHELL * self.spacing)
        off = ~np.isfinite(distance).reshape(self.shape)
        nearest[nearest == tree.n] = 0
        inside = _inside(off)
        depth, skin = ndimage.distance_transform_edt(off, return_indices=True)  # in grid steps
        nearest = nearest.reshape(self.shape)[tuple(skin)].ravel()
        depth, inside = (self.spacing * (depth + _SHELL)).ravel(), inside.ravel()  # of the nearest on the skin's shell
        near = np.where(inside, np.abs(depth - field[nearest]) < reach + _CORRECTION, depth < reach)
        signed = np.where(inside, depth, -depth)
        distance, nearest[near] = tree.query(self.points[near], eps=0.01)
        signed[near] = np.where(inside[near], distance, -distance)
        return signed, nearest


def check_parts(regions: Regions) -> None:
    """Raises InvalidInput if a vertex set or landmark that the head's construction reads is missing."""
    missing = [n for n in NEEDED_SETS if len(regions.vertices.get(n, ())) == 0]
    missing += [n for n in NEEDED_LANDMARKS if n not in regions.landmarks]
    if missing:
        more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
        raise InvalidInput(
            f"regions: the head model lacks {', '.join(missing[:NAMED])}{more}; give this topology a regions file "
            "(docs/own_topology.md)."
        )


def bridge_skin(vertices: FloatArray, faces: IntArray, regions: Regions) -> FloatArray:
    """(n, 3) mm: the skin with ears, lips, nose tip and all openings replaced by the membrane that spans their rims."""
    parts = regions.vertices
    lips = np.setdiff1d(parts["lips"], regions.loops.get("lip_contour", ()))
    rhinion, tip = (vertices[regions.landmarks[n]] for n in ("rhinion", "pronasale"))
    nose = parts["nose"]
    near_tip = np.linalg.norm(vertices[nose] - tip, axis=1) < 0.9 * np.linalg.norm(rhinion - tip)
    free = np.unique(np.concatenate([parts["interior"], parts["ears"], lips, nose[near_tip]]))
    adjacency = vertex_adjacency(faces, len(vertices))
    laplacian = sp.csr_array(sp.diags_array(adjacency.sum(axis=1)) - adjacency)
    fixed = np.setdiff1d(np.arange(len(vertices)), free)
    rows = laplacian[free]
    bridged = vertices.copy()
    bridged[free] = splu(sp.csc_matrix(rows[:, free])).solve(-(rows[:, fixed] @ vertices[fixed]))
    return bridged


def _sample(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, sp.csr_array]:
    """Points on the triangles at most about `_SPACING` apart, and the (m, n) matrix that interpolates there."""
    longest = np.linalg.norm(vertices[faces] - np.roll(vertices[faces], 1, axis=1), axis=2).max(axis=1)
    steps = np.maximum(np.ceil(longest / _SPACING).astype(int), 1)
    rows, columns, values, count = [], [], [], 0
    for step in np.unique(steps):
        triangles = faces[steps == step]
        i, j = np.nonzero(np.add.outer(np.arange(step + 1), np.arange(step + 1)) <= step)
        weights = np.column_stack([i, j, step - i - j]) / step
        m = len(triangles) * len(weights)
        rows.append(np.repeat(count + np.arange(m), 3))
        columns.append(np.repeat(triangles, len(weights), axis=0).ravel())
        values.append(np.tile(weights, (len(triangles), 1)).ravel())
        count += m
    matrix = sp.csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(count, len(vertices))
    )
    points = matrix @ vertices
    apart = np.sort(np.unique(np.floor(points / (_SPACING / 2)), axis=0, return_index=True)[1])
    return points[apart], matrix[apart]


def _cavity_limit(vertices: FloatArray, faces: IntArray, regions: Regions, grid: _Grid) -> FloatArray:
    """Distance in mm of grid points in the tissue from the skin of mouth, eye sockets and ears, less the clearance.

    Ears are bridged, but an ear canal may reach farther in than the bone under the bridge."""
    limit = np.full(len(grid.points), 4 * grid.spacing)
    adjacency = vertex_adjacency(faces, len(vertices))
    for name, clearance in (("interior", CAVITY_CLEARANCE), ("ears", CLEARANCE)):
        members = regions.vertices[name]
        for part in components(adjacency[members][:, members]):
            corners = vertices[members[part]]
            reach = clearance + ROUNDING + 2 * grid.spacing
            box = grid.box(corners.min(axis=0) - reach, corners.max(axis=0) + reach)
            found = signed_distance((vertices, faces), grid.points[box]) - clearance
            limit[box] = np.minimum(limit[box], found)
    return limit


def _base_limit(vertices: FloatArray, regions: Regions, grid: FloatArray) -> FloatArray:
    """Height in mm over the skull's lower limit: the plane through chin and jaw angles, and behind them a level
    half-way up to the ear."""
    mark = {n: vertices[regions.landmarks[n]] for n in NEEDED_LANDMARKS}
    chin = mark["menton"]
    angle = 0.5 * (mark["gonion_left"] + mark["gonion_right"])
    ear = 0.5 * (mark["tragion_left"] + mark["tragion_right"])
    forward, rise = chin[2] - angle[2], chin[1] - angle[1]
    normal = np.array([forward, -rise]) / np.hypot(forward, rise)  # of the plane, in (y, z)
    jaw = (grid[:, 1] - chin[1]) * normal[0] + (grid[:, 2] - chin[2]) * normal[1]
    occiput = grid[:, 1] - 0.5 * (angle[1] + ear[1])
    behind = 1 / (1 + np.exp((grid[:, 2] - angle[2] + 8.0) / 2.0))
    blend: FloatArray = (1 - behind) * jaw + behind * occiput
    return blend


def _smooth_minimum(a: FloatArray, b: FloatArray, radius: float) -> FloatArray:
    """min(a, b), rounded where they differ by less than `radius`."""
    blend = np.maximum(radius - np.abs(a - b), 0.0) / radius
    result: FloatArray = np.minimum(a, b) - 0.25 * radius * blend**2
    return result


def _inside(clear: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which points of a grid the skin encloses; `clear` says which are off it. A corner of the grid is air."""
    labels, _ = ndimage.label(clear)
    nearest = ndimage.distance_transform_edt(~clear, return_distances=False, return_indices=True)
    enclosed: NDArray[np.bool_] = labels[tuple(nearest)] != labels[0, 0, 0]
    return enclosed


def _level_set(values: FloatArray, limit: FloatArray, grid: _Grid) -> tuple[FloatArray, IntArray]:
    """The zero surface of min(smoothed values, limit) on a grid, positive inside: its large pieces, filled.

    The values are smoothed, not the surface, so that it cannot cross itself."""
    far = 4 * grid.spacing
    values = ndimage.gaussian_filter(np.clip(values, -far, far).reshape(grid.shape), 1.0)
    values = np.minimum(values, limit.reshape(grid.shape))
    pieces, count = ndimage.label(values > 0)
    if count == 0:
        raise InvalidInput("skull: expected room for it under the skin, got none; are depths and head both in mm?")
    size = np.bincount(pieces.ravel())[1:] * grid.spacing**3
    kept = np.isin(pieces, 1 + np.flatnonzero(size > min(_SMALLEST_PIECE, size.max() / 2)))  # cranium, jaw
    rest, _ = ndimage.label(~kept)
    holes = ~kept & (rest != rest[0, 0, 0])
    values = np.where(kept | ((pieces == 0) & ~holes), values, -grid.spacing)
    values = np.where(holes, grid.spacing, values)
    image = pv.ImageData(dimensions=grid.shape, spacing=(grid.spacing,) * 3, origin=tuple(grid.low))
    image["inner"] = values.ravel(order="F")
    contour = image.contour([0.0], scalars="inner", method="marching_cubes").clean()
    faces: IntArray = np.asarray(contour.regular_faces, dtype=np.int64)
    if not contour.is_manifold:
        raise InvalidInput(
            "skull: expected a closed surface, got one with open or forked edges; "
            "the depths are too large for this head, or its skin is not closed."
        )
    v = np.asarray(contour.points, dtype=np.float64)
    if np.einsum("ij,ij->", v[faces[:, 0]], np.cross(v[faces[:, 1]], v[faces[:, 2]])) < 0:
        faces = faces[:, ::-1]
    return v, faces
