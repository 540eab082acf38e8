"""Closed loops of mesh edges: open edges, loops traced along a curve, the parts of a mesh that loops separate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from retarget.check import InvalidInput
from retarget.geometry.graph import components, half_edges, vertex_adjacency
from retarget.types import FloatArray, IntArray

WIDTH = 2.0  # mm off the curve at which an edge costs twice its length
TURN = 25.0  # mm of length that a turn by 90 degrees costs
CORRIDOR = 12.0  # mm off the curve beyond which no vertex is used
SIDE = 4.0  # mm off the curve that a normal counts which is off the curve's by 60 degrees


def boundary_loops(faces: IntArray) -> list[IntArray]:
    """The open edges as closed loops of vertices, in the direction of their triangles; loops that touch are refused."""
    ends = half_edges(faces)
    directed = {(int(a), int(b)) for a, b in ends}
    following: dict[int, int] = {}
    for a, b in sorted(directed):
        if (b, a) not in directed:
            if a in following:
                raise InvalidInput(f"faces: expected separate open edges, got two that meet at vertex {a}; close one.")
            following[a] = b
    loops = []
    while following:
        rim = [next(iter(following))]
        while (ahead := following.pop(rim[-1])) != rim[0]:
            rim.append(ahead)
        loops.append(np.array(rim, dtype=np.int64))
    return loops


def is_edge_cycle(loop: IntArray, faces: IntArray, vertex_count: int) -> bool:
    """Whether each vertex of the loop has an edge to the next, the last to the first, and none comes twice."""
    if len(loop) < 3 or len(np.unique(loop)) < len(loop):
        return False
    adjacency = vertex_adjacency(faces, vertex_count)
    return bool(np.all(np.asarray(adjacency[loop, np.roll(loop, -1)]) > 0))


def trace(
    name: str,
    curve: tuple[FloatArray, FloatArray],
    through: Mapping[int, int],
    vertices: FloatArray,
    normals: FloatArray,
    faces: IntArray,
) -> IntArray:
    """The closed loop of edges along a closed curve of m points and their normals (m, 3), in its direction.

    `through` gives the vertices that the loop must hold, by the number of their point on the curve; elsewhere the
    loop is the cheapest path: edges cost their length, more the further they are off the curve, and turns cost too, so
    that a loop stays on one row of a mesh whose rows run along it. Raises InvalidInput where no simple loop exists.
    """
    points, facing = curve
    features = np.hstack([points, SIDE * facing])
    tree = cKDTree(np.hstack([vertices, SIDE * normals]))
    stops = dict(through)
    while len(stops) < 4:  # the middle of the widest gap
        at = sorted(stops) or [0]
        gap, start = max(((b - a - 1) % len(points) + 1, a) for a, b in zip(at, [*at[1:], at[0]], strict=True))
        number = (start + gap // 2) % len(points)
        near = tree.query(features[number], k=len(stops) + 1)[1]
        stops[number] = int(np.setdiff1d(near, list(stops.values()), assume_unique=True)[0])
    loop = _through(name, features, stops, vertices, normals, faces)
    if len(through) < 4:  # again, through the middles between those stops, so that the mesh decides and not the picks
        places = np.flatnonzero(np.isin(loop, list(stops.values())))
        gaps = (np.roll(places, -1) - places - 1) % len(loop) + 1
        stops = dict(through)
        for vertex in loop[(places + gaps // 2) % len(loop)].tolist():
            there = np.r_[vertices[vertex], SIDE * normals[vertex]]
            number = int(np.argmin(np.linalg.norm(features - there, axis=1)))
            if vertex not in stops.values():
                stops.setdefault(number, vertex)
        loop = _through(name, features, stops, vertices, normals, faces)
    if len(np.unique(loop)) < len(loop):
        raise InvalidInput(f"{name}: expected a simple closed loop, got one that meets itself; check its landmarks.")
    return loop


def _through(
    name: str,
    curve: FloatArray,
    through: Mapping[int, int],
    vertices: FloatArray,
    normals: FloatArray,
    faces: IntArray,
) -> IntArray:
    """The cheapest loop through the given vertices along a curve (m, 6) of positions and scaled normals."""
    m = len(curve)
    stops = sorted(through)
    one_way = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    edges = np.concatenate([one_way, one_way[:, ::-1]])
    used = np.zeros(len(vertices), dtype=bool)
    used[list(through.values())] = True
    loop: list[int] = []
    heading = np.zeros(3)
    for start, stop in zip(stops, [*stops[1:], stops[0] + m], strict=True):
        numbers = np.arange(start, stop + 1)
        fine = np.linspace(start, stop, 8 * (stop - start) + 1)
        arc = np.column_stack([np.interp(fine, numbers, column) for column in curve[numbers % m].T])
        away, _ = cKDTree(arc).query(np.hstack([vertices, SIDE * normals]), distance_upper_bound=CORRIDOR)
        a, b = through[start], through[stop % m]
        free = np.isfinite(away) & ~used
        free[[a, b]] = True
        kept = edges[free[edges].all(axis=1)]
        path = _path(vertices, kept, np.minimum(away, CORRIDOR)[kept].mean(axis=1), a, b, heading)
        if path is None:
            raise InvalidInput(
                f"{name}: found no path of edges from vertex {a} to {b}, expected a closed loop near "
                f"{np.round(vertices[a], 1).tolist()} mm. Check the landmarks there in the picture."
            )
        loop += path[:-1]
        used[path] = True
        heading = vertices[path[-1]] - vertices[path[-2]]
    return np.array(loop, dtype=np.int64)


def _path(
    vertices: FloatArray, edges: IntArray, away: FloatArray, first: int, last: int, heading: FloatArray
) -> list[int] | None:
    """The cheapest path over directed edges (e, 2) that lie `away` (e,) mm off the curve, arrived at with a heading
    (3,) mm, zero for none; None without a path."""
    along = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    length = np.linalg.norm(along, axis=1)
    direction = along / np.maximum(length, 1e-12)[:, None]
    cost = length * (1 + (away / WIDTH) ** 2)
    count = len(edges)  # the nodes are the edges; a virtual one before the first and one after the last vertex
    arrive = sp.csr_array((np.ones(count), (edges[:, 1], np.arange(count))), shape=(len(vertices), count))
    leave = sp.csr_array((np.ones(count), (edges[:, 0], np.arange(count))), shape=(len(vertices), count))
    before, after = sp.coo_array(arrive.T @ leave).coords
    forward = edges[before, 0] != edges[after, 1]
    before, after = before[forward], after[forward]
    turn = 1 - np.einsum("ij,ij->i", direction[before], direction[after])
    starts, ends = np.flatnonzero(edges[:, 0] == first), np.flatnonzero(edges[:, 1] == last)
    set_off = cost[starts] + TURN * (1 - direction[starts] @ (heading / max(float(np.linalg.norm(heading)), 1e-12)))
    graph = sp.csr_array(
        (
            np.concatenate([cost[after] + TURN * turn, set_off, np.full(len(ends), 1e-9)]),
            (
                np.concatenate([before, np.full(len(starts), count), ends]),
                np.concatenate([after, starts, np.full(len(ends), count + 1)]),
            ),
        ),
        shape=(count + 2, count + 2),
    )
    _, previous = dijkstra(graph, indices=count, return_predecessors=True)
    path = [last]
    node = int(previous[count + 1])
    while 0 <= node < count:
        path.append(int(edges[node, 0]))
        node = int(previous[node])
    return path[::-1] if path[-1] == first else None


def parts(faces: IntArray, vertex_count: int, loops: Mapping[str, IntArray]) -> dict[frozenset[str], IntArray]:
    """The vertices off all loops, by the names of the loops that their piece of the mesh touches.

    A ring between two loops is named by both, what lies behind one loop by that alone.
    """
    adjacency = vertex_adjacency(faces, vertex_count)
    free = np.ones(vertex_count, dtype=bool)
    for loop in loops.values():
        free[loop] = False
    free &= np.asarray(adjacency.sum(axis=1)).ravel() > 0
    names = np.flatnonzero(free)
    found: dict[frozenset[str], list[IntArray]] = {}
    for piece in components(sp.csr_array(adjacency[names][:, names])):
        members = names[piece]
        touched = np.unique(adjacency[members].indices)
        key = frozenset(name for name, loop in loops.items() if np.isin(loop, touched).any())
        found.setdefault(key, []).append(members)
    return {key: np.sort(np.concatenate(pieces)) for key, pieces in found.items()}
