"""The skull of a face: the surface that lies as deep under the skin as the published depths say.

The skin without ears, lips and nose tip is bridged smoothly where these were; the skull is the level set of
(distance to that skin - depth), kept off the eye sockets and cut off from the neck.
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

from retarget.anatomy.closed import euler_number
from retarget.anatomy.depths import LARGEST, depth_basis
from retarget.check import InvalidInput
from retarget.geometry.graph import vertex_adjacency
from retarget.types import FloatArray, IntArray, Regions

NEEDED_SETS = ("head", "interior", "ears", "lips", "nose", "eyes", "neck")
NEEDED_LANDMARKS = ("rhinion", "pronasale", "menton", "gonion_left", "gonion_right", "tragion_left", "tragion_right")
SOCKET_CLEARANCE = 2.0  # mm of soft tissue between an eye socket and its orbit
ROUNDING = 3.0  # mm over which the lower edges of mandible and occiput and the orbits' edges are rounded
TOLERANCE = 0.2  # mm that the depth at a landmark may be off; the fit to a face promises 1 mm
_SPACING = 2.0  # mm between the samples of the skin
_REACH = 30.0  # mm that the skin is looked for from a point; no depth comes near it
_SHELL = 1.25  # grid steps about the skin in which a point's side is that of the nearest point beyond
_ROUNDS = 6  # of correcting the depths at the landmarks


@dataclass(frozen=True)
class Skull:
    """A closed surface, and how far its depths at the landmarks are off the table's, by landmark name in mm."""

    vertices: FloatArray  # (n, 3) mm
    faces: IntArray  # (f, 3), outward
    errors: Mapping[str, float]


def build_skull(
    vertices: FloatArray, faces: IntArray, regions: Regions, depths: Mapping[str, float], spacing: float = 2.0
) -> Skull:
    """The skull under a capped head (n, 3) mm, (f, 3); `depths` in mm by landmark, `spacing` of the grid in mm.

    The field is corrected until the distance from each landmark to the skull is the depth of the table, where the
    shape of the skin lets it. Raises InvalidInput if a region or landmark is missing, or if the level set is not one
    closed piece, and if a depth lies outside (0, 24] mm.
    """
    check_parts(regions)
    bridged = bridge_skin(vertices, faces, regions)
    names = list(depths)
    marks = np.array([regions.landmarks[name] for name in names])
    wanted = np.array([depths[name] for name in names])
    if not ((wanted > 0) & (wanted <= LARGEST)).all():
        raise InvalidInput(
            f"depths: expected depths in (0, {LARGEST:g}] mm, got {wanted.min():g} to {wanted.max():g}; are they in mm?"
        )
    samples, weights = _sample(bridged, faces)
    margin = 3 * spacing  # the air about the head is one piece
    low, high = vertices.min(axis=0) - margin, vertices.max(axis=0) + margin
    shape = tuple(int(s) for s in np.ceil((high - low) / spacing).astype(int) + 1)
    grid = low + spacing * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    distance, nearest = cKDTree(samples).query(grid, eps=0.01, distance_upper_bound=_REACH)
    distance, nearest = np.minimum(distance, _REACH), np.minimum(nearest, len(samples) - 1)  # deep inside
    inside = _inside(distance.reshape(shape) > _SHELL * spacing).ravel()
    signed = np.where(inside, distance, -distance)
    limit = np.minimum(_socket_limit(vertices, faces, regions, grid), _base_limit(vertices, regions, grid))
    basis = depth_basis(vertices, faces, marks)
    given = wanted.copy()
    for _ in range(_ROUNDS):
        field = weights @ np.clip(basis @ given, wanted.min() / 2, 0.9 * _REACH)
        surface = _level_set(_smooth_minimum(signed - field[nearest], limit, ROUNDING).reshape(shape), low, spacing)
        found = distance_to(surface, vertices[marks])
        if np.abs(found - wanted).max() < TOLERANCE:
            break
        given = np.clip(given + wanted - found, 0.5 * wanted, 1.5 * wanted)
    return Skull(*surface, dict(zip(names, (found - wanted).tolist(), strict=True)))


def check_parts(regions: Regions) -> None:
    """Raises InvalidInput if a vertex set or landmark that the head's construction reads is missing."""
    missing = [f"vertices[{n!r}]" for n in NEEDED_SETS if len(regions.vertices.get(n, ())) == 0]
    missing += [f"landmarks[{n!r}]" for n in NEEDED_LANDMARKS if n not in regions.landmarks]
    if missing:
        raise InvalidInput(
            f"regions: expected what the volumetric head needs, {', '.join(missing)} missing; "
            "docs/regions.md says what each name means. Add it to the topology's regions."
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


def distance_to(surface: tuple[FloatArray, IntArray], points: FloatArray) -> FloatArray:
    """(m,) mm from points (m, 3) to the triangles of a surface."""
    mesh = pv.PolyData.from_regular_faces(surface[0], surface[1])  # type: ignore[arg-type]  # its stub wants int
    _, closest = mesh.find_closest_cell(points, return_closest_point=True)
    result: FloatArray = np.linalg.norm(points - closest, axis=1)
    return result


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
    return matrix @ vertices, matrix


def _socket_limit(vertices: FloatArray, faces: IntArray, regions: Regions, grid: FloatArray) -> FloatArray:
    """Distance in mm from the inner surface of the eye sockets, less the clearance: positive away from them."""
    interior = regions.vertices["interior"]
    middle = vertices[regions.vertices["eyes"]].mean(axis=0)[1] - 25.0
    inside = np.zeros(len(vertices), dtype=bool)
    inside[interior[vertices[interior, 1] > middle]] = True
    inside[regions.vertices["eyes"]] = True
    samples, _ = _sample(vertices, faces[inside[faces].all(axis=1)])
    distance, _ = cKDTree(samples).query(grid, distance_upper_bound=40.0)
    limit: FloatArray = np.minimum(distance, 40.0) - SOCKET_CLEARANCE
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


def _level_set(values: FloatArray, low: FloatArray, spacing: float) -> tuple[FloatArray, IntArray]:
    """The zero surface of values on a grid, positive inside: its largest piece, filled.

    The values are smoothed, not the surface, so that it cannot cross itself."""
    values = ndimage.gaussian_filter(np.clip(values, -4 * spacing, 4 * spacing), 1.0)
    pieces, count = ndimage.label(values > 0)
    if count == 0:
        raise InvalidInput("skull: expected room for it under the skin, got none; are depths and head both in mm?")
    largest = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    rest, _ = ndimage.label(pieces != largest)
    holes = (pieces != largest) & (rest != rest[0, 0, 0])
    values = np.where((pieces == largest) | ((pieces == 0) & ~holes), values, -spacing)
    values = np.where(holes, spacing, values)
    image = pv.ImageData(dimensions=values.shape, spacing=(spacing,) * 3, origin=tuple(low))
    image["inner"] = values.ravel(order="F")
    contour = image.contour([0.0], scalars="inner", method="marching_cubes").clean()
    contour = contour.connectivity("largest").extract_surface(algorithm=None) if contour.n_points else contour
    faces: IntArray = np.asarray(contour.regular_faces, dtype=np.int64)
    if not contour.is_manifold or euler_number(faces) != 2:
        raise InvalidInput(
            f"skull: expected a closed surface without handles, got Euler number {euler_number(faces)}; "
            "the depths are too large for this head, or its skin is not closed."
        )
    v = np.asarray(contour.points, dtype=np.float64)
    if np.einsum("ij,ij->", v[faces[:, 0]], np.cross(v[faces[:, 1]], v[faces[:, 2]])) < 0:
        faces = faces[:, ::-1]
    return v, faces
