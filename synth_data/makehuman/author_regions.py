"""Computes ``regions.json`` from the base head, the face units and the hand-picked seeds below.

    python -m synth_data.makehuman.author_regions [wheel]

rewrites the file. What the mesh and the motion can tell is computed: lip, lid and socket loops are quad loops, the
mouth cavity and the eye sockets lie behind them, larger regions are bounded by shortest paths through a few
waypoints, jaw and cranium follow from jawOpen and from what no unit moves. The seeds name the left half and the
midline; the right half is their mirror image.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from retarget.geometry.procrustes import rigid_align
from retarget.geometry.strip import strip
from retarget.io.regions import encode
from retarget.types import AffinePoint, FloatArray, IntArray, Regions
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.regions import FILE
from synth_data.makehuman.targets import load_head

STATIC_MM = 0.7  # moved less than this by every unit: `cranium`
NEARLY_STATIC_MM = 1.0  # `cranium_skin`
CRANIUM_SHARE, JAW_SHARE = 0.2, 0.5  # of the rigid jaw motion under jawOpen

# Quad loops: two neighbours, the walk starts at the first and heads to the second.
LOOPS = {
    "lip_contour": (455, 2651),  # vermilion border
    "lip_inner": (474, 2666),  # where the lips meet
    "lid_margin_left": (2287, 2284),  # front edge of the lid rim, from the inner corner over the upper lid
    "eye_socket_left": (2331, 2330),  # the outermost closed loop round the lids
}
WET_LIP = 520  # middle of the upper lip; behind the loop through it lies the mouth cavity
LID_BACK = (3226, 3225)  # back edge of the lid rim; behind it lies the eye socket
EAR_ROOT = (4270, 4267)
LIP_ROWS = (455, 466, 467, 509, 468, 474, 520)  # middle of the upper lip, vermilion border to wet lip

JAW_LINE = (732, 3046, 3119, 3124, 3125, 3122, 3121, 3044)
FACE_BACK = (3044, 3002, 4281, 4288, 4279, 4292, 4283, 4298, 4294)  # in front of the ear
HAIRLINE = (4294, 4093, 4092, 3925, 2478, 2456, 2455, 3106, 975)
NAPE = (3044, 2895, 3017, 3065, 3823, 3818, 1706)
BROW = (2420, 2417, 2416, 2418, 2419, 2461, 2468, 2442, 2441, 2439, 2440, 2445, 2443, 2420)
NOSE = (136, 2348, 2343, 2344, 2426, 2395, 3795, 3792, 2410, 3685, 2494, 2556, 2557, 2514, 343)
CHEEK = (
    2397, 3791, 3793, 3633, 3843, 3840, 3789, 3041, 3038, 3034, 2430, 2465, 3725, 3863, 3729, 3730, 3744, 2475, 3776,
    3004, 3645, 3005, 3045, 3028, 3027, 2894, 3836, 3769, 3718, 3689, 2872, 3536, 2871, 2574, 2573, 2571, 3866, 3622,
    2397,
)  # fmt: skip
JAW = (491, 2677, 2671, 2881, 2889, 2888, 3498, 2884, 3688, 3702, 3718, 3769, 3836, 2894, 3027, 3028, 3121)

# Landmarks of the Rhine soft-tissue table and of anthropometry.
MIDLINE_LANDMARKS = {
    "supraglabella": 1742,
    "glabella": 227,
    "nasion": 132,
    "rhinion": 1485,
    "pronasale": 297,
    "subnasale": 343,
    "mid_philtrum": 1764,
    "prosthion": 455,
    "labrale_superius": 455,
    "stomion_upper": 474,
    "stomion_lower": 493,
    "labrale_inferius": 492,
    "infradentale": 492,
    "supramentale": 724,
    "pogonion": 1584,
    "menton": 732,
}
LEFT_LANDMARKS = {
    "frontal_eminence": 2447,
    "supraorbital": 2416,
    "suborbital": 3761,
    "inferior_malar": 3599,
    "lateral_orbit": 3034,
    "zygion": 2475,
    "supraglenoid": 4292,
    "gonion": 2896,
    "supra_m2": 3751,
    "mid_masseter": 3782,
    "sub_m2": 3048,
    "tragion": 3986,
    "exocanthion": 2245,
    "endocanthion": 2287,
    "alare": 3601,
    "cheilion": 2599,
}
# The 51 inner landmarks of iBUG-68, the left half by place in the list; a right one is the image of its partner.
IBUG_MIDLINE = {10: 132, 11: 131, 12: 201, 13: 297, 16: 343, 34: 455, 40: 492, 45: 474, 49: 493}
IBUG_LEFT = {
    5: 2420, 6: 2434, 7: 2433, 8: 2435, 9: 2461,
    17: 2491, 18: 2556,
    25: 2287, 26: 2275, 27: 2221, 28: 2245, 29: 2262, 30: 2268,
    35: 2652, 36: 2607, 37: 2599, 38: 2603, 39: 2678,
    46: 2663, 47: 2629, 48: 2673,
}  # fmt: skip
IBUG_PARTNER = {
    5: 4, 6: 3, 7: 2, 8: 1, 9: 0, 17: 15, 18: 14, 25: 22, 26: 21, 27: 20, 28: 19, 29: 24, 30: 23,
    35: 33, 36: 32, 37: 31, 38: 42, 39: 41, 46: 44, 47: 43, 48: 50,
}  # fmt: skip

# The jaw joint: 12 mm before the tragus and 17 mm under the skin, on the line between two skin points.
CONDYLE_SKIN, CONDYLE_WEIGHT = 2995, 0.88


def author_regions(head: BaseHead, units: Mapping[str, FloatArray]) -> Regions:
    """Regions of the base head; units are the displacements (n, 3) mm of the face units by name."""
    mesh = _Mesh(head)
    mirror = head.mirror

    loops = {name: mesh.quad_loop(*start) for name, start in LOOPS.items()}
    wet_lip, lid_back = mesh.quad_loop(WET_LIP, mesh.left_neighbour(WET_LIP)), mesh.quad_loop(*LID_BACK)

    left: dict[str, IntArray] = {}  # regions of the left half, with the midline
    both: dict[str, IntArray] = {}  # regions that are their own mirror image
    mouth = mesh.behind(wet_lip, 588)
    socket = mesh.behind(lid_back, 3229)
    both["interior"] = _union(mouth, socket, mirror[socket])
    both["head"] = np.setdiff1d(np.arange(mesh.count), both["interior"])

    rows = np.array([mesh.quad_loop(v, mesh.left_neighbour(v)) for v in LIP_ROWS])
    corner = int(np.flatnonzero(rows[0] == LEFT_LANDMARKS["cheilion"])[0])
    both["upper_lip"] = np.unique(np.roll(rows, corner, axis=1)[:, : 2 * corner + 1])
    both["lower_lip"] = np.unique(rows[:, corner : rows.shape[1] - corner + 1])
    both["lips"] = _union(both["upper_lip"], both["lower_lip"])

    rim, orbit = loops["lid_margin_left"], loops["eye_socket_left"]
    left["eyes"] = mesh.within([orbit, lid_back], 2221)
    outer_corner = int(np.flatnonzero(rim == LEFT_LANDMARKS["exocanthion"])[0])
    upper, lower = rim[1:outer_corner], rim[outer_corner + 1 :]

    jaw_line, back, hairline = mesh.path(JAW_LINE), mesh.path(FACE_BACK), mesh.path(HAIRLINE)
    nape = mesh.path(NAPE)
    ear = mesh.within([mesh.quad_loop(*EAR_ROOT)], 4062)
    face = mesh.within([jaw_line, back, hairline, wet_lip, lid_back], 1476, half=True)
    both["neck"] = mesh.symmetric(np.setdiff1d(mesh.within([jaw_line, nape], 807, half=True), jaw_line))
    both["ears"] = _union(ear, mirror[ear])
    both["face"] = mesh.symmetric(face)
    both["scalp"] = np.setdiff1d(both["head"], _union(both["face"], both["ears"], both["neck"]))

    both["nose"] = mesh.symmetric(mesh.within([mesh.path(NOSE)], 1476, half=True))
    left["cheeks"] = mesh.within([mesh.path(CHEEK)], 3697, half=True)
    left["brows"] = mesh.within([mesh.path(BROW)], 2434, half=True)
    both["jaw"] = mesh.symmetric(mesh.within([mesh.path(JAW), jaw_line], 1584, half=True))
    for name in ("cheeks", "brows", "eyes"):
        both[name] = mesh.symmetric(left[name])

    motion = np.max([np.linalg.norm(delta, axis=1) for delta in units.values()], axis=0)
    share = _jaw_share(head.vertices, units["jawOpen"], both["jaw"])
    skull = np.setdiff1d(_union(both["face"], both["scalp"]), _union(both["ears"], both["eyes"], both["jaw"]))
    above = skull[head.vertices[skull, 1] > head.vertices[LEFT_LANDMARKS["exocanthion"], 1]]
    both["cranium"] = above[motion[above] < STATIC_MM]
    both["cranium_skin"] = skull[(motion[skull] < NEARLY_STATIC_MM) & (share[skull] < CRANIUM_SHARE)]
    both["jaw_skin"] = both["jaw"][share[both["jaw"]] > JAW_SHARE]
    loops["neck"] = mesh.boundary_loop()
    both["neck_boundary"] = np.sort(loops["neck"])

    one_sided = {"cheek": left["cheeks"], "brow": left["brows"], "eye": left["eyes"], "ear": ear}
    one_sided |= {"lid_margin_upper": upper, "lid_margin_lower": lower}
    vertices = {name: np.unique(mesh.symmetric(indices)) for name, indices in both.items()}
    for name, indices in one_sided.items():
        vertices[f"{name}_left"], vertices[f"{name}_right"] = np.sort(indices), np.sort(mirror[indices])
    for name in ("lid_margin", "eye_socket"):
        loops[f"{name}_right"] = mirror[loops[f"{name}_left"]]

    ring = mesh.within([orbit, rim], 2366)
    triangles = {
        "eye_socket_left": np.flatnonzero(np.isin(head.faces, ring).all(axis=1)),
        "eye_socket_right": np.flatnonzero(np.isin(head.faces, mirror[ring]).all(axis=1)),
    }
    orbit_corner = int(np.flatnonzero(orbit == 2398)[0])
    patches = {
        "eye_opening_left": strip(head.vertices, rim, outer_corner),
        "eye_socket_left": strip(head.vertices, orbit, orbit_corner),
    }
    for name in list(patches):
        patches[name.replace("left", "right")] = mirror[patches[name]][:, ::-1]

    skin = np.array([CONDYLE_SKIN, mirror[CONDYLE_SKIN]])
    weights = np.array([CONDYLE_WEIGHT, 1 - CONDYLE_WEIGHT])
    return Regions(
        vertices=dict(sorted(vertices.items())),
        loops=dict(sorted(loops.items())),
        triangles=triangles,
        patches=dict(sorted(patches.items())),
        landmarks=_landmarks(mirror),
        points={"condyle_left": AffinePoint(skin, weights), "condyle_right": AffinePoint(mirror[skin], weights)},
        mirror=mirror,
    )


def _landmarks(mirror: IntArray) -> dict[str, int]:
    found = dict(MIDLINE_LANDMARKS)
    for name, vertex in LEFT_LANDMARKS.items():
        found[f"{name}_left"], found[f"{name}_right"] = vertex, int(mirror[vertex])
    ibug = IBUG_MIDLINE | IBUG_LEFT | {IBUG_PARTNER[i]: int(mirror[vertex]) for i, vertex in IBUG_LEFT.items()}
    return dict(sorted(found.items())) | {f"ibug_{i:02d}": ibug[i] for i in range(51)}


def _jaw_share(vertices: FloatArray, jaw_open: FloatArray, chin: IntArray) -> FloatArray:
    """(n,) how much of the jaw's rigid motion each vertex shows under jawOpen, 1 for the bone itself.

    The rigid motion is fitted to the skin that moves most, where it follows the bone best.
    """
    moved = np.linalg.norm(jaw_open[chin], axis=1)
    firm = chin[moved > np.quantile(moved, 0.6)]
    rotation, translation = rigid_align(vertices[firm], vertices[firm] + jaw_open[firm])
    rigid = vertices @ rotation.T + translation - vertices
    return np.sum(rigid * jaw_open, axis=1) / np.sum(rigid**2, axis=1)


def _union(*sets: IntArray) -> IntArray:
    return np.unique(np.concatenate(sets))


class _Mesh:
    """Walks on the head: quad loops, shortest paths, and the parts that such walls enclose."""

    def __init__(self, head: BaseHead):
        self.count = len(head.vertices)
        self._vertices, self._mirror = head.vertices, head.mirror
        self._quads = head.faces.reshape(-1, 2, 3)[:, [0, 0, 0, 1], [0, 1, 2, 2]]
        self._left = head.vertices[:, 0] > -1e-6
        self._neighbours: dict[int, set[int]] = defaultdict(set)
        self._quads_of: dict[frozenset[int], list[int]] = defaultdict(list)
        for k, quad in enumerate(self._quads.tolist()):
            for a, b in zip(quad, quad[1:] + quad[:1], strict=True):
                self._neighbours[a].add(b)
                self._neighbours[b].add(a)
                self._quads_of[frozenset((a, b))].append(k)
        ends = np.unique(np.sort(head.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
        self._edges = np.concatenate([ends, ends[:, ::-1]])
        quad_ends = np.array([sorted(edge) for edge in self._quads_of])
        self._lengths = self._graph(np.concatenate([quad_ends, quad_ends[:, ::-1]]))

    def quad_loop(self, first: int, second: int) -> IntArray:
        """The loop of quad edges that leaves first for second and goes straight on at every vertex."""
        loop = [first, second]
        while True:
            a, b = loop[-2:]
            beside = {v for k in self._quads_of[frozenset((a, b))] for v in self._quads[k].tolist()}
            ahead = self._neighbours[b] - beside
            if second not in self._neighbours[first] or len(self._neighbours[b]) != 4 or len(ahead) != 1:
                raise ValueError(f"no quad loop through {first}-{second}: the walk ends at vertex {b}")
            (following,) = ahead
            if following == first:
                return np.array(loop, dtype=np.int64)
            loop.append(following)

    def left_neighbour(self, vertex: int) -> int:
        """The neighbour of a midline vertex that lies furthest to the left."""
        return max(self._neighbours[vertex], key=lambda v: self._vertices[v, 0])

    def path(self, waypoints: Iterable[int]) -> IntArray:
        """Sorted vertices of the shortest path on the left half through the waypoints in turn."""
        points = list(waypoints)
        graph = self._lengths[self._left][:, self._left]
        names = np.flatnonzero(self._left)
        here = np.searchsorted(names, points)
        _, before = dijkstra(graph, indices=here[:-1], return_predecessors=True)
        visited = set(here.tolist())
        for row, start, end in zip(before, here[:-1], here[1:], strict=True):
            while (end := row[end]) != start:
                visited.add(int(end))
        return np.sort(names[sorted(visited)])

    def within(self, walls: list[IntArray], seed: int, half: bool = False) -> IntArray:
        """Sorted vertices reached from the seed without crossing the walls, the touched walls included."""
        wall = np.concatenate(walls)
        reached = self.behind(wall, seed, half)
        touching = self._edges[np.isin(self._edges[:, 0], reached), 1]
        return _union(reached, np.intersect1d(wall, touching))

    def behind(self, wall: IntArray, seed: int, half: bool = False) -> IntArray:
        """Sorted vertices reached from the seed without crossing the wall, the wall excluded."""
        free = ~np.isin(np.arange(self.count), wall)
        if half:
            free &= self._left
        edges = self._edges[free[self._edges].all(axis=1)]
        return np.flatnonzero((part := connected_components(self._graph(edges))[1]) == part[seed])

    def symmetric(self, indices: IntArray) -> IntArray:
        """The set with its mirror image."""
        return _union(indices, self._mirror[indices])

    def boundary_loop(self) -> IntArray:
        """The open edge of the neck, from the front to the left."""
        following: dict[int, list[int]] = defaultdict(list)
        for edge, quads in self._quads_of.items():
            if len(quads) == 1:
                a, b = edge
                following[a].append(b)
                following[b].append(a)
        front = max(following, key=lambda v: (self._vertices[v, 2], -abs(self._vertices[v, 0])))
        loop = [front, max(following[front], key=lambda v: self._vertices[v, 0])]
        while (ahead := next(v for v in following[loop[-1]] if v != loop[-2])) != front:
            loop.append(ahead)
        return np.array(loop, dtype=np.int64)

    def _graph(self, edges: IntArray) -> csr_array:
        lengths = np.linalg.norm(self._vertices[edges[:, 0]] - self._vertices[edges[:, 1]], axis=1)
        return csr_array((lengths, (edges[:, 0], edges[:, 1])), shape=(self.count, self.count))


def main(arguments: list[str]) -> None:
    """Rewrite the data beside this module; an argument names a wheel file."""
    head, targets = load_head(wheel=Path(arguments[0]) if arguments else None, progress=print)
    units = {name.removeprefix("units/"): targets[name] for name in targets if name.startswith("units/")}
    Path(__file__).with_name(FILE).write_text(encode(author_regions(head, units)))


if __name__ == "__main__":
    main(sys.argv[1:])
