"""Closed surfaces: the neck's cap, and the checks that meshing needs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from retarget.anatomy.crossings import self_intersections
from retarget.check import InvalidInput
from retarget.geometry.graph import half_edges
from retarget.types import FloatArray, IntArray


def cap(name: str, vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Close the neck, the one boundary loop of (n, 3), (f, 3), by a fan about its mean, a new vertex at the end.

    Raises InvalidInput for further holes, vertices without a triangle, an edge of three triangles, triangles of
    different orientation, or loops that touch.
    """
    loose = np.setdiff1d(np.arange(len(vertices)), faces)
    if len(loose):
        raise InvalidInput(
            f"{name}: expected a triangle at every vertex, got none at {len(loose)} of {len(vertices)}, the first is "
            f"vertex {loose[0]}; remove them, and close the hole that they may mark."
        )
    edges = half_edges(faces)
    low, high = np.sort(edges, axis=1).T
    keys, uses = np.unique(low * len(vertices) + high, return_counts=True)
    if uses.max() > 2:
        a, b = divmod(int(keys[np.argmax(uses)]), len(vertices))
        raise InvalidInput(
            f"{name}: expected at most two triangles at an edge, got {uses.max()} at vertices {a} and {b}; "
            "remove what does not belong to the skin."
        )
    forth, back = edges @ [len(vertices), 1], edges @ [1, len(vertices)]
    if len(np.unique(forth)) < len(forth):
        raise InvalidInput(f"{name}: expected triangles of one orientation, got neighbours that disagree; orient them.")
    following: dict[int, int] = {}
    for a, b in edges[~np.isin(forth, back)][np.argsort(forth[~np.isin(forth, back)])].tolist():
        if b in following:
            raise InvalidInput(f"{name}: expected separate boundary loops, got two that meet at vertex {b}; close one.")
        following[b] = a
    loops = list(_loops(following))
    if not loops:
        return vertices, faces
    lengths = [float(np.linalg.norm(np.diff(vertices[[*loop, loop[0]]], axis=0), axis=1).sum()) for loop in loops]
    neck = loops.pop(int(np.argmax(lengths)))
    if loops:
        where = np.round(vertices[loops[0]].mean(axis=0), 1).tolist()
        raise InvalidInput(
            f"{name}: expected one opening, the neck, got {len(loops)} more, the first of {len(loops[0])} edges near "
            f"{where} mm; fill the holes."
        )
    vertices = np.vstack([vertices, vertices[neck].mean(axis=0)])
    fan = np.column_stack([neck, np.roll(neck, -1), np.full(len(neck), len(vertices) - 1)])
    return vertices, np.vstack([faces, fan])


def _loops(following: dict[int, int]) -> Iterator[list[int]]:
    """The cycles of a permutation, each as a list."""
    while following:
        first, second = next(iter(following.items()))
        loop = [first]
        del following[first]
        while second != first:
            loop.append(second)
            second = following.pop(second)
        yield loop


def euler_number(faces: IntArray) -> int:
    """V - E + F over the vertices in use; 2 for a sphere."""
    edges = np.unique(np.sort(half_edges(faces), axis=1), axis=0)
    return len(np.unique(faces)) - len(edges) + len(faces)


def check_closed(name: str, vertices: FloatArray, faces: IntArray) -> None:
    """Raises InvalidInput unless the surface is closed, like a sphere (Euler number 2), outward and free of
    self-intersections."""
    edges = np.sort(half_edges(faces), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    if (uses != 2).any():
        raise InvalidInput(
            f"{name}: expected a closed surface, got {int((uses != 2).sum())} edges without two triangles; close "
            "the holes (the neck is closed by itself, other openings are not)."
        )
    number = euler_number(faces)
    if number != 2:
        raise InvalidInput(
            f"{name}: expected Euler number 2, one closed piece without handles, got {number}; remove eyes, teeth and "
            "other separate pieces, and fill tunnels."
        )
    if np.einsum("ij,ij->", vertices[faces[:, 0]], np.cross(vertices[faces[:, 1]], vertices[faces[:, 2]])) <= 0:
        raise InvalidInput(f"{name}: expected triangles that face outward, got inward ones; reverse their order.")
    pairs = self_intersections(vertices, faces)
    if len(pairs):
        raise InvalidInput(
            f"{name}: expected a surface without self-intersections, got {len(pairs)} pairs of crossing triangles, the "
            f"first {pairs[0].tolist()} near {np.round(vertices[faces[pairs[0, 0]]].mean(axis=0), 1).tolist()} mm; "
            "open lips and lids in the pose, or repair the mesh there."
        )
