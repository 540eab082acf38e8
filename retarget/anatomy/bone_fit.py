"""The skull of a character: the template's, warped with the skin and then moved smoothly until its depths are right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from retarget.anatomy.closed import cap
from retarget.anatomy.depths import LARGEST, cavity_faces
from retarget.anatomy.distance import Surface, closest, distance_to, signed_distance
from retarget.anatomy.skull import bridge_skin
from retarget.anatomy.warp import farthest_points
from retarget.types import FloatArray, IntArray, Regions

CLEARANCE = 1.0  # mm of tissue that the skull keeps under all skin, less only where the template has less
TOLERANCE = 0.5  # mm that the depth at a landmark may be off without being corrected; the rule is 1 mm
LARGEST_TOLERANCE = 0.8  # mm, where the template itself is off by as much
SMOOTH = 24.0  # mm within which a correction of the skull fades
_MARGIN = 0.2  # mm beyond the clearance that a shallow vertex is sent
_OVERSHOOT = 4.0  # mm that the aim at a landmark may be off the wanted depth
_ROUNDS = 15
_CAVITY_WALL = 10.0  # mm about mouth and eye sockets in which bone does not follow the depth field
_SAMPLES, _CENTRES = 800, 400
_RIDGE = 0.01  # of the bumps' height, so that centres that contradict each other compromise


@dataclass(frozen=True)
class SkullFit:
    """How a skull lies under a skin."""

    errors: Mapping[str, float]  # mm by landmark, found less wanted
    clearance: float  # mm from the skin to the nearest skull vertex, negative outside


@dataclass(frozen=True)
class Skin:
    """A skin as the skull sees it."""

    surface: Surface  # closed at the neck
    bridged: Surface  # without ears, lips, nose tip and openings
    regions: Regions

    @staticmethod
    def of(vertices: FloatArray, faces: IntArray, regions: Regions) -> Skin:
        """From an open skin (n, 3) mm, (f, 3)."""
        surface = cap("skin", vertices, faces)
        return Skin(surface, (bridge_skin(*surface, regions), surface[1]), regions)

    def depth(self, points: FloatArray) -> FloatArray:
        """(p,) mm under the skin, negative outside."""
        return signed_distance(self.surface, points)

    def inward(self, points: FloatArray, depth: FloatArray) -> FloatArray:
        """(p, 3) the directions in which the `depth` of points (p, 3) mm grows."""
        return _unit((points - closest(self.surface, points)) * np.where(depth < 0, -1.0, 1.0)[:, None])


def place_skull(
    skull: Surface, skin: Skin, start: FloatArray, new: Skin, depths: Mapping[str, float], least: float = CLEARANCE
) -> FloatArray:
    """Move the skull vertices `start` (k, 3) mm, faces as in `skull`, under the skin `new`.

    The distances from the landmarks become `depths` in mm; it keeps `least` mm under all skin, or nearly what the
    template's `skull` keeps under its `skin`. The corrections are smooth in space. A skull that is right already is
    returned unchanged.
    """
    rest, faces = skull
    at = [new.regions.landmarks[name] for name in depths]
    marks, wanted = new.surface[0][at], np.array(list(depths.values()))
    own = skin.depth(rest)
    clearance = np.minimum(least, 0.8 * own)
    tolerance = np.clip(np.abs(distance_to(skull, skin.surface[0][at]) - wanted) + 0.01, TOLERANCE, LARGEST_TOLERANCE)
    x = start
    radius, depth = wanted.copy(), np.zeros(len(x))
    for _ in range(_ROUNDS):
        near = depth < least  # a bound: the others cannot have come so near by their moves
        depth[near] = new.depth(x[near])
        errors = distance_to((x, faces), marks) - wanted
        off, shallow = np.abs(errors) > tolerance, depth < clearance
        if not (off.any() or shallow.any()):
            break
        radius[off] = np.clip(radius - errors, wanted - _OVERSHOOT, wanted + _OVERSHOOT)[off]
        step, held = np.zeros_like(x), shallow.copy()
        inward = new.inward(x[shallow], depth[shallow])
        step[shallow] = (clearance + _MARGIN - depth)[shallow, None] * inward
        for mark, reach, wrong in zip(marks, radius, off, strict=True):
            distance = np.linalg.norm(mark - x, axis=1)
            moved = distance <= max(reach, distance.min())
            held |= moved
            if wrong:
                step[moved] += (1 - reach / distance[moved])[:, None] * (mark - x[moved])
        moves = _bumps(x[held], step[held], x)
        x, depth = x + moves, depth - np.linalg.norm(moves, axis=1)
    return x


def measure_skull(surface: Surface, skin: Skin, depths: Mapping[str, float]) -> SkullFit:
    """How a skull lies under a skin, against the `depths` in mm by landmark."""
    marks = skin.surface[0][[skin.regions.landmarks[name] for name in depths]]
    errors = distance_to(surface, marks) - np.array(list(depths.values()))
    clearance = float(signed_distance(skin.surface, surface[0]).min())
    return SkullFit(dict(zip(depths, errors.tolist(), strict=True)), clearance)


def follow_depths(rest: FloatArray, skin: Skin, start: FloatArray, new: Skin) -> FloatArray:
    """(k, 3) mm: the skull vertices `start` (k, 3) mm moved by a smooth step towards the depths under the bridged skin
    `new` that the template's, `rest` (k, 3) mm, have under its `skin`."""
    own = skin.depth(rest)
    deep = np.linalg.norm(rest - closest(skin.bridged, rest), axis=1)
    cavities = cavity_faces(skin.surface[1], skin.regions, len(skin.surface[0]))
    off_cavities = distance_to((skin.surface[0], cavities), rest) > _CAVITY_WALL
    outer = np.flatnonzero((deep < LARGEST) & (np.abs(own - deep) < 1.0) & off_cavities)
    outer = outer[farthest_points(rest[outer], _SAMPLES)]
    foot = start[outer] - closest(new.bridged, start[outer])
    wanted = (deep[outer] - np.linalg.norm(foot, axis=1))[:, None] * _unit(foot)
    kernel = _kernel(start, start[outer])
    moved: FloatArray = start + kernel @ wanted / (kernel.sum(axis=1, keepdims=True) + 0.1)
    return moved


def _bumps(centres: FloatArray, steps: FloatArray, points: FloatArray) -> FloatArray:
    """(p, 3) mm: a sum of bumps in space that moves centres (c, 3) mm by about `steps`, and far points not at all.

    In space and not along the surface, so that both sides of a thin bone move together.
    """
    chosen = farthest_points(centres, _CENTRES)
    weights = np.linalg.solve(_kernel(centres[chosen], centres[chosen]) + _RIDGE * np.eye(len(chosen)), steps[chosen])
    moved: FloatArray = _kernel(points, centres[chosen]) @ weights
    return moved


def _kernel(points: FloatArray, centres: FloatArray) -> FloatArray:
    """(p, c): Wendland's C2 function of the distance, zero beyond `SMOOTH`."""
    r = np.minimum(cdist(points, centres) / SMOOTH, 1.0)
    inward = np.square(1 - r)
    bump: FloatArray = inward * inward * (4 * r + 1)
    return bump


def _unit(vectors: FloatArray) -> FloatArray:
    unit: FloatArray = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return unit
