"""Collisions between upper and lower lip (section 3.3.2, forward simulation step 3; after Komaritzan et al. 2021)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra

from retarget.check import InvalidInput
from retarget.geometry.graph import vertex_adjacency
from retarget.simulation.facing import FacingSurface, Gaps, Samples, vertex_normals
from retarget.simulation.penetration import SKIN, Surface, inside
from retarget.types import FloatArray, IntArray, Regions

TRIGGER = 0.05  # mm: shallower contacts are left alone
DEEP = 1.0  # mm: what lies deeper at rest is in no contact but folded, and no candidate
REACH = 16.0  # mm: how far the inner sides of the lips count as lips
NEAR = 1.0  # mm: surfaces that are further apart do not touch
CROSSING = 0.5  # mm
SHALLOW = 2.0  # mm: the nearest point is on the right side of a lip up to this depth


class Lips:
    """The two lips of a skin, and where they are in each other.

    A lip is its set in `regions` and what lies behind it outside of `head`, the visible skin, up to REACH. Looked at
    are its vertices and the centres of its triangles, but for the corners of the mouth, which both sets hold.
    # differs from the paper: it looks at points of the lower lip alone, and straight up, where a lip that has passed
    the other one in front of it or behind it finds nothing. Lips may touch at rest, and neutrals with crossed lips
    stay as they are: points that are inside at rest count where they go deeper.

    There are two measures. `gaps` is fast and local, for the solver. `depth` trusts nothing of it: it takes the
    winding number of the whole skin.
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
        upper, lower = with_inner_sides(rest, faces, sets[0], sets[1], regions.vertices.get("head"))
        corners = np.intersect1d(sets[0], sets[1])
        across = faces[np.isin(faces, upper).any(axis=1) & np.isin(faces, lower).any(axis=1)]
        self._seam = np.union1d(corners, across)  # where one lip goes over into the other
        self.vertices: IntArray = np.union1d(upper, lower)  # (p,) in the order of `gaps`
        self.upper_faces = np.ascontiguousarray(faces[np.isin(faces, upper).all(axis=1)])  # (u, 3)
        self.lower_faces = np.ascontiguousarray(faces[np.isin(faces, lower).all(axis=1)])  # (l, 3)
        self._faces = np.ascontiguousarray(faces, dtype=np.int64)
        place = np.full(len(rest), -1)
        place[self.vertices] = np.arange(len(self.vertices))
        self._own = np.ascontiguousarray(place[faces[np.isin(faces, self.vertices).all(axis=1)]])
        lips = (lower, self.lower_faces, self.upper_faces), (upper, self.upper_faces, self.lower_faces)
        self._pairs, self._measured = [], []
        for points, own, other in lips:
            points = np.setdiff1d(points, corners)
            own = own[~np.isin(own, corners).any(axis=1)]
            samples = Samples.of(place[points], place[own])
            self._pairs.append((samples, FacingSurface(place[other], len(self.vertices))))
            self._measured.append((points, own, Surface(other)))
        self.samples = Samples(
            *(np.concatenate(part) for part in zip(*(_parts(s) for s, _ in self._pairs), strict=True))
        )
        resting = self.gaps(rest[self.vertices]).gap
        self.floor = np.where(resting < -DEEP, -np.inf, np.minimum(resting, 0.0))  # (s,) mm
        self._resting = [np.zeros(samples.count) for samples, _ in self._pairs]
        self._resting = self._inside(rest)

    def gaps(self, points: FloatArray, reach: float = SHALLOW) -> Gaps:
        """How far all samples are from the other lip, at the lips' `vertices` in points (p, 3) mm."""
        x = np.ascontiguousarray(points, dtype=np.float64)
        normals = vertex_normals(x, self._own)
        return Gaps.stack([other.gaps(x, normals, samples, NEAR, reach) for samples, other in self._pairs])

    def meet(self, points: FloatArray) -> bool:
        """Whether any sample passes TRIGGER by `gaps`. It looks no deeper than CROSSING: where surfaces cross, some
        samples are shallow."""
        return bool((self.floor - self.gaps(points, CROSSING).gap).max(initial=0.0) > TRIGGER)

    def depth(self, skin: FloatArray) -> float:
        """mm: how deep any sample lies inside of the whole skin (n, 3) mm: its distance from the other lip, at most
        10 mm, beyond that at rest.

        What has its nearest point of the other lip where one lip goes over into the other, as at the corners of the
        mouth, lies in the fold between them, not in that lip.
        """
        found = zip(self._inside(skin), self._resting, strict=True)
        return max(float((depth - resting).max(initial=0.0)) for depth, resting in found)

    def _inside(self, skin: FloatArray) -> list[FloatArray]:
        """Of each lip the depths (s,) mm of its samples, 0 outside."""
        triangles = np.vstack([own for _, own, _ in self._measured])
        a, b, c = (skin[triangles[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        x = np.vstack([skin, (a + b + c) / 3 + SKIN * normal / np.where(length > 0, length, 1.0)])
        samples, first = [], len(skin)
        for points, own, _ in self._measured:
            samples.append(np.concatenate([points, np.arange(first, first + len(own))]))
            first += len(own)
        found = np.split(inside(x, self._faces, np.concatenate(samples)), [len(samples[0])])
        depths = []
        for places, is_inside, (_, _, other) in zip(samples, found, self._measured, strict=True):
            within = np.flatnonzero(is_inside)
            distance, corners, weights = other.nearest(x, places[within])
            folded = ((weights <= 0) | np.isin(corners, self._seam)).all(axis=1) & (weights.sum(axis=1) > 0)
            depth = np.zeros(len(places))
            depth[within] = np.where(folded, 0.0, distance)
            depths.append(depth)
        return depths


def _parts(samples: Samples) -> tuple[IntArray, FloatArray]:
    return samples.corners, samples.weights


def with_inner_sides(
    rest: FloatArray, faces: IntArray, upper: IntArray, lower: IntArray, visible: IntArray | None
) -> tuple[IntArray, IntArray]:
    """Both lips with the hidden vertices that clearly lie behind them: along the surface at most REACH away, and nearer
    than the other lip."""
    hidden = np.ones(len(rest), dtype=bool)
    hidden[np.arange(len(rest)) if visible is None else visible] = False
    edges = vertex_adjacency(faces, len(rest)).tocoo()
    inner = hidden[edges.row] | hidden[edges.col]
    start, end = edges.row[inner], edges.col[inner]
    graph = sp.csr_array((np.linalg.norm(rest[start] - rest[end], axis=1), (start, end)), shape=edges.shape)
    to_upper, to_lower = (dijkstra(graph, indices=lip, min_only=True, limit=REACH) for lip in (upper, lower))
    upper = np.union1d(upper, np.flatnonzero(hidden & (to_upper < to_lower)))
    lower = np.union1d(lower, np.flatnonzero(hidden & (to_lower < to_upper)))
    return upper, lower
