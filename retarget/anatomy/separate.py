"""Lips that touch, moved apart for meshing: a smooth local displacement, up at the upper and down at the lower one."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from retarget.anatomy.closed import cap, check_closed
from retarget.anatomy.crossings import self_intersections
from retarget.check import InvalidInput
from retarget.geometry.cholesky import CholeskyFactor
from retarget.geometry.graph import vertex_adjacency
from retarget.types import FloatArray, IntArray, Regions

STEPS = (1.5, 2.0, 3.0, 4.5, 6.0)  # mm that each lip or lid moves; the first that helps is taken
CORNER = 8.0  # mm from the corners over which the motion grows
LIPS = ("lip_inner", "upper_lip", "lower_lip", 30.0)
LIDS = tuple(
    (f"lid_margin_{side}", f"lid_margin_upper_{side}", f"lid_margin_lower_{side}", 12.0) for side in ("left", "right")
)
"""Loop where both sides meet, the set above, the set below, mm along the skin beyond which nothing moves."""


def separate(vertices: FloatArray, faces: IntArray, regions: Regions) -> FloatArray:
    """The head (n, 3) mm with its lips apart, and its lids where they cross, so that it can be meshed.

    Both sides move by the least of `STEPS` that leaves no crossing triangles; skin farther than 30 mm from the lips
    (12 mm from the lids) stays. Raises InvalidInput where triangles cross elsewhere, where no step helps, where a
    loop or set is missing, and as `check_closed` does.
    """
    _, closed = cap("head", vertices, faces)
    direction, near = _apart(vertices, faces, regions, *LIPS)
    crossing = _crossing(vertices, faces, closed)
    for lids in LIDS:
        if lids[0] in regions.loops:
            lid_direction, at_lids = _apart(vertices, faces, regions, *lids)
            if at_lids[crossing].any():
                direction, near = direction + lid_direction, near | at_lids
    stuck = crossing[~near[crossing]]
    if len(stuck):
        raise InvalidInput(
            f"head: expected crossing triangles at lips and lids alone, got some near vertex {stuck[0]} at "
            f"{np.round(vertices[stuck[0]], 1).tolist()} mm; repair the mesh there."
        )
    for step in STEPS:
        moved = vertices + np.outer(step * direction, [0.0, 1.0, 0.0])
        crossing = _crossing(moved, faces, closed)
        if not len(crossing):
            check_closed("head", *cap("head", moved, faces))
            return moved
    raise InvalidInput(
        f"head: lips or lids cross still near {np.round(moved[crossing[0]], 1).tolist()} mm when each is moved by "
        f"{STEPS[-1]:g} mm. Open them in the mesh, or give an expression with the mouth a little open."
    )


def lip_parting(vertices: FloatArray, faces: IntArray, regions: Regions) -> FloatArray:
    """(n,) how far each vertex of the head (n, 3) mm moves up when lips part by 1 mm each.

    1 at the upper lip, -1 at the lower one, 0 at the corners and away from the mouth. Raises InvalidInput where a loop
    or set is missing.
    """
    return _apart(vertices, faces, regions, *LIPS)[0]


def _crossing(vertices: FloatArray, faces: IntArray, closed: IntArray) -> IntArray:
    """Vertices of triangles that pass through each other; the cap's own are left out."""
    capped, _ = cap("head", vertices, faces)
    found = np.unique(closed[self_intersections(capped, closed)])
    return found[found < len(vertices)]


def _apart(
    vertices: FloatArray, faces: IntArray, regions: Regions, name: str, above: str, below: str, reach: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(n,) how far each vertex moves up, 1 above and -1 below the loop and 0 at its corners; and which are in reach."""
    missing = [n for n in (above, below) if n not in regions.vertices] + [name] * (name not in regions.loops)
    if missing:
        raise InvalidInput(
            f"regions: expected {', '.join(missing)} to move lips and lids apart, found none; docs/regions.md says "
            "what each is. Add it to the topology's regions."
        )
    loop = regions.loops[name]
    side = np.isin(loop, regions.vertices[above]).astype(np.float64) - np.isin(loop, regions.vertices[below])
    at_corner = cKDTree(vertices[loop[side == 0]]) if (side == 0).any() else None
    if at_corner is not None:
        t = np.clip(at_corner.query(vertices[loop])[0] / CORNER, 0, 1)
        side *= t * (2 - t)
    adjacency = vertex_adjacency(faces, len(vertices))
    a, b = sp.coo_array(adjacency).coords
    lengths = sp.csr_array((np.linalg.norm(vertices[a] - vertices[b], axis=1), (a, b)), shape=adjacency.shape)
    near = np.isfinite(dijkstra(lengths, indices=loop, min_only=True, limit=reach))
    free = np.setdiff1d(np.flatnonzero(near), loop)
    laplacian = sp.csr_array(sp.diags_array(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency)
    rows = sp.csr_array(laplacian @ laplacian)[free]  # bends least
    amount = np.zeros(len(vertices))
    amount[loop] = side
    amount[free] = CholeskyFactor(sp.csc_array(rows[:, free]), name).solve(-(rows[:, loop] @ side))
    return amount, near
