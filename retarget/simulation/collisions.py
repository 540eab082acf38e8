"""Collisions between upper and lower lip (section 3.3.2, forward simulation step 3; after Komaritzan et al. 2021)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from retarget.check import InvalidInput
from retarget.geometry.graph import vertex_adjacency
from retarget.simulation.penetration import Surface, inside
from retarget.types import FloatArray, IntArray, Regions

TRIGGER = 0.05  # mm: shallower contacts are left alone
DEEP = 1.0  # mm: what lies deeper at rest is in no contact but folded, and no candidate
REACH = 10.0  # mm: how far the inner sides of the lips count as lips


@dataclass(frozen=True)
class Contacts:
    """Skin points inside of the other lip, each with a point of that lip's surface: straight below or above, or the
    nearest."""

    points: IntArray  # (k,)
    triangles: IntArray  # (k, 3) vertices of the triangle that holds the other point
    barycentric: FloatArray  # (k, 3)
    depth: FloatArray  # (k,) mm, the distance of the two

    @property
    def count(self) -> int:
        return len(self.points)

    @property
    def deepest(self) -> float:
        """mm; 0 without contacts."""
        return float(self.depth.max(initial=0.0))

    def deeper_than(self, depths: FloatArray) -> Contacts:
        """Those deeper than what depths (n,) mm says for their points."""
        keep = self.depth > depths[self.points]
        return Contacts(self.points[keep], self.triangles[keep], self.barycentric[keep], self.depth[keep])

    def half_way(self, skin: FloatArray) -> FloatArray:
        """(k, 3) mm: from each point half the way to its counterpart, on skin (n, 3) mm."""
        counterparts = np.einsum("kc,kci->ki", self.barycentric, skin[self.triangles])
        return 0.5 * (counterparts - skin[self.points])


@dataclass(frozen=True)
class Held:
    """Contacts that are held, and where."""

    contacts: Contacts
    goals: FloatArray  # (k, 3) mm of the points
    counterparts: FloatArray  # (k, 3) mm of the counterparts

    @classmethod
    def none(cls) -> Held:
        empty = np.empty((0, 3))
        return cls(Contacts(np.empty(0, np.int64), np.empty((0, 3), np.int64), empty, np.empty(0)), empty, empty)

    def renewed(self, found: Contacts, skin: FloatArray, push: float) -> Held:
        """With contacts found on skin (n, 3) mm while these were held.

        Point and counterpart of a new one go to their average position. A point that is found although it is held
        gets a goal `push` times the remaining half way further on than its last one.
        """
        half = found.half_way(skin)
        again, where = _position(found.points, self.contacts.points)
        goals = skin[found.points] + half
        goals[again] = self.goals[where] + push * half[again]
        stay = ~np.isin(self.contacts.points, found.points)
        old = self.contacts
        contacts = Contacts(
            np.concatenate([old.points[stay], found.points]),
            np.concatenate([old.triangles[stay], found.triangles]),
            np.concatenate([old.barycentric[stay], found.barycentric]),
            np.concatenate([old.depth[stay], found.depth]),
        )
        average = skin[found.points] + half
        return Held(contacts, np.vstack([self.goals[stay], goals]), np.vstack([self.counterparts[stay], average]))

    def rows(self, n: int) -> tuple[sp.csr_array, FloatArray]:
        """The (r, n) matrix of what is held of vertices (n, 3), and the goals (r, 3): all points, and the counterparts
        in triangles with a corner that is not held itself.

        To hold the other counterparts as well would ask for lips that are flat: the points of each would have to lie
        in the triangles of the other.
        """
        contacts = self.contacts
        loose = np.flatnonzero(~np.isin(contacts.triangles, contacts.points).all(axis=1))
        count = contacts.count + len(loose)
        index = np.concatenate([np.arange(contacts.count), np.repeat(np.arange(contacts.count, count), 3)])
        columns = np.concatenate([contacts.points, contacts.triangles[loose].ravel()])
        weights = np.concatenate([np.ones(contacts.count), contacts.barycentric[loose].ravel()])
        matrix = sp.csr_array((weights, (index, columns)), shape=(count, n))
        return matrix, np.vstack([self.goals, self.counterparts[loose]])


def _position(values: IntArray, among: IntArray) -> tuple[NDArray[np.bool_], IntArray]:
    """Which values (k,) occur `among` others (m,), without repetition there, and where those that do."""
    order = np.argsort(among)
    place = np.minimum(np.searchsorted(among, values, sorter=order), max(len(among) - 1, 0))
    if not len(among):
        return np.zeros(len(values), dtype=bool), np.empty(0, dtype=np.int64)
    found = among[order[place]] == values
    return found, order[place[found]]


class Lips:
    """The two lips of a skin, and where they have passed each other.

    A lip is its set in `regions` and what lies behind it outside of `head`, the visible skin, up to REACH. A point of
    the lower lip is inside of the upper one if the first triangle of the upper lip straight below it faces down; the
    other way round for points of the upper lip. # differs from the paper: it looks at points of the lower lip alone,
    which leaves points of the upper lip inside where the lower lip is meshed more coarsely.
    Candidates are all points of a lip, but for the corners of the mouth, which both sets hold. Lips may touch at rest,
    and neutrals with crossed lips stay as they are: points that are inside at rest count where they go deeper.
    What that rule does not see, as nothing of the other lip is straight below, the winding number of the whole skin
    shows; see `hidden`.
    """

    def __init__(self, rest: FloatArray, faces: IntArray, regions: Regions) -> None:
        """rest: neutral skin (n, 3) mm. Raises InvalidInput if `upper_lip` or `lower_lip` is missing."""
        sets = [np.asarray(regions.vertices.get(name, ()), dtype=np.int64) for name in ("upper_lip", "lower_lip")]
        for name, part in zip(("upper_lip", "lower_lip"), sets, strict=True):
            if not len(part):
                raise InvalidInput(
                    f"regions: expected vertices[{name!r}] for lip collisions, got none; add it to the topology's "
                    "regions, or switch collisions off."
                )
        upper, lower = _with_inner_sides(rest, faces, sets[0], sets[1], regions.vertices.get("head"))
        corners = np.intersect1d(sets[0], sets[1])
        self.vertices: IntArray = np.union1d(upper, lower)
        self.upper_faces = np.ascontiguousarray(faces[np.isin(faces, upper).all(axis=1)])  # (u, 3)
        self.lower_faces = np.ascontiguousarray(faces[np.isin(faces, lower).all(axis=1)])  # (l, 3)
        self._upper, self._lower = np.setdiff1d(upper, corners), np.setdiff1d(lower, corners)
        self._allowed = np.full(len(rest), TRIGGER)
        resting = self.contacts(rest)
        self._allowed[resting.points] += np.where(resting.depth < DEEP, resting.depth, np.inf)
        self._faces = np.ascontiguousarray(faces, dtype=np.int64)
        self._surfaces = Surface(self.upper_faces), Surface(self.lower_faces)
        self._resting = np.zeros(len(rest))
        inner = self._inside(rest)
        self._resting[inner.points] = inner.depth

    def contacts(self, skin: FloatArray) -> Contacts:
        """All points of skin (n, 3) mm that are deeper in the other lip than TRIGGER, and by as much than at rest.
        Only the lips' `vertices` are looked at."""
        x = np.ascontiguousarray(skin, dtype=np.float64)
        below = _passed(x, self._lower, self.upper_faces, 1.0, self._allowed)
        above = _passed(x, self._upper, self.lower_faces, -1.0, self._allowed)
        return Contacts(*(np.concatenate(pair) for pair in zip(below, above, strict=True)))

    def hidden(self, skin: FloatArray) -> Contacts:
        """All points of the whole skin (n, 3) mm that lie inside of it, and further from the other lip than TRIGGER,
        and by as much than at rest, each with the nearest point of the other lip."""
        return self._inside(skin).deeper_than(self._resting + TRIGGER)

    def depth(self, skin: FloatArray) -> float:
        """mm: how deep any point of a lip but the corners lies inside of the whole skin (n, 3) mm: its distance from
        the other lip, beyond that at rest."""
        found = self._inside(skin)
        return float((found.depth - self._resting[found.points]).max(initial=0.0))

    def _inside(self, skin: FloatArray) -> Contacts:
        parts = []
        for points, other in zip((self._upper, self._lower), self._surfaces[::-1], strict=True):
            within = points[inside(skin, self._faces, points)]
            distances, triangles, barycentric = other.nearest(skin, within)
            parts.append((within, triangles, barycentric, distances))
        return Contacts(*(np.concatenate(pair) for pair in zip(*parts, strict=True)))


def _with_inner_sides(
    rest: FloatArray, faces: IntArray, upper: IntArray, lower: IntArray, visible: IntArray | None
) -> tuple[IntArray, IntArray]:
    """Both lips with the hidden vertices that clearly lie behind them: along the surface at most REACH away, and twice
    as near as the other lip, which leaves out the corners."""
    hidden = np.ones(len(rest), dtype=bool)
    hidden[np.arange(len(rest)) if visible is None else visible] = False
    edges = vertex_adjacency(faces, len(rest)).tocoo()
    inner = hidden[edges.row] | hidden[edges.col]
    start, end = edges.row[inner], edges.col[inner]
    graph = sp.csr_array((np.linalg.norm(rest[start] - rest[end], axis=1), (start, end)), shape=edges.shape)
    to_upper, to_lower = (dijkstra(graph, indices=lip, min_only=True, limit=REACH) for lip in (upper, lower))
    return (
        np.union1d(upper, np.flatnonzero(hidden & (to_upper < 0.5 * to_lower))),
        np.union1d(lower, np.flatnonzero(hidden & (to_lower < 0.5 * to_upper))),
    )


@njit(cache=True)
def _passed(x, points, faces, up, allowed):  # type: ignore[no-untyped-def]
    """Points that went `up` (1 or -1) through the surface: index, triangle, barycentric coordinates and depth."""
    low, high = np.empty((len(faces), 2)), np.empty((len(faces), 2))
    for f in range(len(faces)):
        for i in range(2):
            a, b, c = x[faces[f, 0], 2 * i], x[faces[f, 1], 2 * i], x[faces[f, 2], 2 * i]
            low[f, i], high[f, i] = min(a, b, c), max(a, b, c)
    found = np.empty(len(points), np.int64)
    triangle, coordinates, depths = (
        np.empty((len(points), 3), np.int64),
        np.empty((len(points), 3)),
        np.empty(len(points)),
    )
    count = 0
    for k in range(len(points)):
        px, py, pz = x[points[k], 0], x[points[k], 1], x[points[k], 2]
        nearest, entered = np.inf, False
        for f in range(len(faces)):
            if px < low[f, 0] or px > high[f, 0] or pz < low[f, 1] or pz > high[f, 1]:
                continue
            a, b, c = faces[f]
            ux, uz = x[b, 0] - x[a, 0], x[b, 2] - x[a, 2]
            vx, vz = x[c, 0] - x[a, 0], x[c, 2] - x[a, 2]
            normal = uz * vx - ux * vz  # vertical component of the normal
            if normal == 0:
                continue
            wx, wz = px - x[a, 0], pz - x[a, 2]
            s = (wz * vx - wx * vz) / normal
            t = (uz * wx - ux * wz) / normal
            if s < -1e-9 or t < -1e-9 or s + t > 1 + 1e-9:
                continue
            r = 1 - s - t
            depth = up * (py - (r * x[a, 1] + s * x[b, 1] + t * x[c, 1]))
            if 0 <= depth < nearest:
                nearest, entered = depth, up * normal < 0
                triangle[count, 0], triangle[count, 1], triangle[count, 2] = a, b, c
                coordinates[count, 0], coordinates[count, 1], coordinates[count, 2] = r, s, t
        if entered and nearest > allowed[points[k]]:
            found[count], depths[count] = points[k], nearest
            count += 1
    return found[:count], triangle[:count], coordinates[:count], depths[:count]
