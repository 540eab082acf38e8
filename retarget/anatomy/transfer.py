"""Regions of a reference head on another topology, for a person to check in a picture.

The reference is registered to the head. Loops become closed loops of edges along the registered ones; they cut both
meshes into the same parts (face, lips, mouth, lids, sockets), and within a part every name follows the closest point.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from retarget.anatomy.landmarks import LANDMARKS, check_landmarks, check_pose
from retarget.check import InvalidInput, check_faces, check_vertices
from retarget.geometry.edge_loops import boundary_loops, parts, trace
from retarget.geometry.graph import vertex_adjacency
from retarget.geometry.oriented import OrientedSurface, oriented, vertex_normals
from retarget.geometry.registration import register
from retarget.geometry.strip import strip
from retarget.types import AffinePoint, FloatArray, IntArray, Regions

RIM = 2  # edges from the open edge of the neck within which the reference does not look for the head


def transfer_regions(
    reference: tuple[FloatArray, IntArray, Regions],
    vertices: FloatArray,
    faces: IntArray,
    landmarks: Mapping[str, int],
) -> Regions:
    """Regions of the head (n, 3) mm, (f, 3) from those of a reference head (vertices in mm, faces, regions).

    `landmarks` are vertices of the head by the names of the reference's landmarks; `LANDMARKS` are a good minimum.
    They are kept as they are. A loop of open edges becomes the nearest open edge. ``mirror`` is None. Raises
    InvalidInput for landmarks that are unknown, too few, out of range or do not fit the head, for a head in another
    unit than mm, and where a loop does not close or does not separate what it separates on the reference.
    """
    vertices = check_vertices("head", vertices)
    faces = check_faces("head", faces, len(vertices))
    ref_vertices, ref_faces, ref = reference
    ours, theirs = check_landmarks(landmarks, ref, len(vertices))
    check_pose(ref_vertices[ours], vertices[theirs])
    rim = np.concatenate([np.empty(0, dtype=np.int64), *boundary_loops(ref_faces)])
    reached = np.isin(np.arange(len(ref_vertices)), rim)
    for _ in range(RIM):
        reached |= vertex_adjacency(ref_faces, len(ref_vertices)) @ reached > 0
    followed = np.flatnonzero(~reached)
    registered = register(ref_vertices, ref_faces, followed, vertices, faces, (ours, theirs))
    return _Transfer((registered, ref_faces, ref), (vertices, faces), landmarks).regions()


class _Transfer:
    """The reference where it lies on the head, and what is asked of it."""

    def __init__(
        self,
        reference: tuple[FloatArray, IntArray, Regions],
        head: tuple[FloatArray, IntArray],
        given: Mapping[str, int],
    ) -> None:
        self.registered, self.ref_faces, self.ref = reference
        self.vertices, self.faces = head
        self.given = given
        self.ref_normals = vertex_normals(self.registered, self.ref_faces)
        self.normals = vertex_normals(self.vertices, self.faces)
        rims = {frozenset(rim.tolist()) for rim in boundary_loops(self.ref_faces)}
        self.walls = {name: loop for name, loop in self.ref.loops.items() if frozenset(loop.tolist()) not in rims}
        self.head = OrientedSurface(self.vertices, self.faces, normals=self.normals)
        self.loops = self._loops()
        self.ref_part, self.part = self._parts()
        ref_part = self.ref_part[self.ref_faces].max(axis=1)
        self.ref_triangles = [np.flatnonzero(ref_part == number) for number in range(ref_part.max() + 1)]
        self.surfaces = [
            OrientedSurface(self.registered, self.ref_faces[ids], normals=self.ref_normals)
            for ids in self.ref_triangles
        ]

    def regions(self) -> Regions:
        sources = self._sources()
        return Regions(
            vertices={name: self._vertex_set(sources, members) for name, members in self.ref.vertices.items()},
            loops=self.loops,
            triangles=self._triangle_sets(),
            patches={name: made for name in self.ref.patches if (made := self._patch(name)) is not None},
            landmarks={name: self._landmark(name) for name in self.ref.landmarks},
            points={name: self._point(point) for name, point in self.ref.points.items()},
            mirror=None,
        )

    def _loops(self) -> dict[str, IntArray]:
        """Walls traced along the registered ones, open edges by what lies nearest."""
        found = {}
        for name, loop in self.walls.items():
            number = {int(v): i for i, v in enumerate(loop)}
            marks = {
                number[v]: self.given[n]
                for n in LANDMARKS
                if n in self.given and (v := self.ref.landmarks[n]) in number
            }
            curve = self.registered[loop], self.ref_normals[loop]
            found[name] = trace(f"loops[{name!r}]", curve, marks, self.vertices, self.normals, self.faces)
        rims = boundary_loops(self.faces)
        for name in [n for n in self.ref.loops if n not in self.walls and rims]:
            wanted = self.registered[self.ref.loops[name]]
            gap = [float(np.linalg.norm(self.vertices[rim].mean(axis=0) - wanted.mean(axis=0))) for rim in rims]
            found[name] = _in_step(wanted, self.vertices, rims[int(np.argmin(gap))])
        return dict(sorted(found.items()))

    def _parts(self) -> tuple[IntArray, IntArray]:
        """What the walls separate, as numbers for the vertices of the reference and of the head; -1 on a wall."""
        theirs = parts(self.ref_faces, len(self.registered), self.walls)
        mine = parts(self.faces, len(self.vertices), {name: self.loops[name] for name in self.walls})
        if frozenset() in mine:
            raise InvalidInput(
                f"head: expected one connected piece, the skin, got others of {len(mine[frozenset()])} vertices; "
                "leave out eyeballs, teeth and lashes, see isolate_skin."
            )
        if extra := [key for key in mine if key not in theirs]:
            raise InvalidInput(
                f"loops: expected {', '.join(sorted(extra[0]))} to separate the head as on the reference, but a part "
                f"of {len(mine[extra[0]])} vertices touches just these; check the landmarks there, in the picture."
            )
        keys = sorted(theirs, key=sorted)
        ref_part, part = np.full(len(self.registered), -1), np.full(len(self.vertices), -1)
        for number, key in enumerate(keys):
            ref_part[theirs[key]] = number
            part[mine.get(key, [])] = number
        return ref_part, part

    def _sources(self) -> IntArray:
        """(n,) the reference vertex that each vertex of the head corresponds to, so that sets keep their relations."""
        source = np.full(len(self.vertices), -1)
        for number, surface in enumerate(self.surfaces):
            here = np.flatnonzero(self.part == number)
            sample = surface.closest(self.vertices[here], self.normals[here])
            corners = surface.corners[sample]
            share = np.where(self.ref_part[corners] == number, surface.weights[sample], -1.0)  # a wall keeps to itself
            source[here] = corners[np.arange(len(here)), share.argmax(axis=1)]
        for name, loop in self.loops.items():
            curve = self.ref.loops[name]
            source[loop] = curve[self._on_reference(curve, loop)]
        return source

    def _vertex_set(self, sources: IntArray, members: IntArray) -> IntArray:
        """Vertices whose reference vertex belongs to the set; of a set on a loop, those on that loop."""
        found: IntArray = np.flatnonzero(np.isin(sources, members))
        for name, loop in self.loops.items():
            if np.isin(members, self.ref.loops[name]).all():
                return np.intersect1d(found, loop)
        return found

    def _triangle_sets(self) -> dict[str, IntArray]:
        """Triangles whose centre corresponds to a triangle of the set."""
        centres, normals = self.vertices[self.faces].mean(axis=1), self.normals[self.faces].mean(axis=1)
        part = self.part[self.faces].max(axis=1)  # no triangle reaches across a wall
        source = np.full(len(self.faces), -1)
        for number, (surface, ids) in enumerate(zip(self.surfaces, self.ref_triangles, strict=True)):
            here = np.flatnonzero(part == number)
            source[here] = ids[surface.triangles[surface.closest(centres[here], normals[here])]]
        return {name: np.flatnonzero(np.isin(source, triangles)) for name, triangles in self.ref.triangles.items()}

    def _patch(self, name: str) -> IntArray | None:
        """The strip between the corners of the loop that holds the reference's patch; None without that loop."""
        patch = self.ref.patches[name]
        for loop_name, loop in self.ref.loops.items():
            if loop_name in self.loops and np.isin(patch, loop).all():
                break
        else:
            return None
        used, uses = np.unique(patch, return_counts=True)
        ends = np.flatnonzero(np.isin(loop, used[uses == 1]))  # a strip has one triangle at each of its two ends
        mine = self.loops[loop_name]
        start, corner = self._on_head(mine, loop[ends])
        mine = np.roll(mine, -start)
        made = strip(self.vertices, mine, (corner - start) % len(mine))
        return made if _along(patch, loop) == _along(made, mine) else made[:, ::-1]

    def _landmark(self, name: str) -> int:
        if name in self.given:
            return int(self.given[name])
        vertex = np.array([self.ref.landmarks[name]])
        for loop_name, loop in self.loops.items():
            if vertex[0] in self.ref.loops[loop_name]:
                return int(loop[self._on_head(loop, vertex)[0]])
        there = np.flatnonzero(self.part == self.ref_part[vertex[0]])
        return int(there[self._on_head(there, vertex)[0]])

    def _point(self, point: AffinePoint) -> AffinePoint:
        """The same combination of the head's points that correspond to the reference's vertices."""
        sample = self.head.closest(self.registered[point.indices], self.ref_normals[point.indices])
        weights = point.weights[:, None] * self.head.weights[sample]
        indices, place = np.unique(self.head.corners[sample], return_inverse=True)
        shares = np.zeros(len(indices))
        np.add.at(shares, place.ravel(), weights.ravel())
        return AffinePoint(indices, shares)

    def _on_head(self, candidates: IntArray, ref_vertices: IntArray) -> IntArray:
        """Which of the head's vertices is the closest to each vertex of the reference."""
        tree = cKDTree(oriented(self.vertices[candidates], self.normals[candidates]))
        found: IntArray = tree.query(oriented(self.registered[ref_vertices], self.ref_normals[ref_vertices]))[1]
        return found

    def _on_reference(self, candidates: IntArray, vertices: IntArray) -> IntArray:
        """Which of the reference's vertices is the closest to each vertex of the head."""
        tree = cKDTree(oriented(self.registered[candidates], self.ref_normals[candidates]))
        found: IntArray = tree.query(oriented(self.vertices[vertices], self.normals[vertices]))[1]
        return found


def _in_step(curve: FloatArray, vertices: FloatArray, loop: IntArray) -> IntArray:
    """The loop, started next to the first point of a closed curve (m, 3) and run in its direction."""

    def area(points: FloatArray) -> FloatArray:
        about = points - points.mean(axis=0)
        total: FloatArray = np.cross(about, np.roll(about, -1, axis=0)).sum(axis=0)
        return total

    if area(curve) @ area(vertices[loop]) < 0:
        loop = loop[::-1]
    return np.roll(loop, -int(np.argmin(np.linalg.norm(vertices[loop] - curve[0], axis=1))))


def _along(patch: IntArray, loop: IntArray) -> bool:
    """Whether the triangles of a patch run along the loop that bounds it."""
    ends = np.concatenate([patch[:, [0, 1]], patch[:, [1, 2]], patch[:, [2, 0]]])
    return bool((ends == (loop[0], loop[1])).all(axis=1).any())
