"""A small block with a mouth, eyes, muscle and bones that is all a `HeadTemplate` has to be."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from retarget.anatomy.head import Head, HeadTemplate
from retarget.types import FloatArray, IntArray, Regions
from tests.retarget.simulation.box import box

CELLS = (16, 14, 5)
SIZE = (64.0, 56.0, 20.0)  # mm; x to the character's left, y up, z out of the face
GAP = 1.0  # mm between the lips, a slit that is 12 mm deep and 40 mm wide


def box_template(cells: tuple[int, int, int] = CELLS) -> HeadTemplate:
    """The mouth is a slit without a cell's height: the layer of vertices in it is doubled and parted by `GAP`."""
    vertices, tets = box(cells, SIZE)
    x, y, z = (vertices - [SIZE[0] / 2, 0, SIZE[2]]).T
    step = SIZE[1] / cells[1]
    mouth = step * (cells[1] // 2)
    slit = np.flatnonzero((np.abs(y - mouth) < 1e-9) & (np.abs(x) < 19.9) & (z > -12.1))
    double = np.full(len(vertices), -1)
    double[slit] = len(vertices) + np.arange(len(slit))
    above = vertices[tets].mean(axis=1)[:, 1] > mouth
    opened = tets.copy()
    opened[above] = np.where(double[tets[above]] >= 0, double[tets[above]], tets[above])
    vertices = np.vstack([vertices, vertices[slit]])
    vertices[slit, 1] -= GAP / 2
    vertices[len(x) :, 1] += GAP / 2
    vertices -= [SIZE[0] / 2, 0, 0]

    boundary = _boundary(opened)
    back = np.flatnonzero(vertices[:, 2] == 0)
    skull_faces = boundary[(vertices[boundary, 2] == 0).all(axis=1)][:, ::-1]
    skin_faces = boundary[~(vertices[boundary, 2] == 0).all(axis=1)]
    used, faces = np.unique(skin_faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    embedding, skin = _embed(vertices, used, faces)
    return HeadTemplate(
        skin=skin,
        faces=faces,
        regions=_regions(vertices[used], used, slit, len(x), mouth),
        vertices=vertices,
        tets=opened,
        muscle=vertices[opened].mean(axis=1)[:, 2] < 8,
        embedding=embedding,
        skull_faces=skull_faces,
        cranium=back[vertices[back, 1] > mouth + 1],
        jaw=back[vertices[back, 1] < mouth - 1],
        depths={},
    )


def box_head(template: HeadTemplate | None = None, shape: FloatArray | None = None) -> Head:
    """The template as a head, or `shape` (3, 3) times it."""
    template = template or box_template()
    linear = np.eye(3) if shape is None else shape
    condyles = np.array([[25.0, 36.0, -20.0], [-25.0, 36.0, -20.0]])
    return Head(template, template.skin @ linear.T, template.vertices @ linear.T, condyles @ linear.T, {})


def _boundary(tets: IntArray) -> IntArray:
    """(f, 3) the faces of one tet alone, outward."""
    faces = np.concatenate([tets[:, [0, 2, 1]], tets[:, [0, 1, 3]], tets[:, [1, 2, 3]], tets[:, [0, 3, 2]]])
    _, first, uses = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[uses == 1])]


def _embed(vertices: FloatArray, used: IntArray, faces: IntArray) -> tuple[sp.csr_array, FloatArray]:
    """Each skin vertex hangs on its tet vertex and, a little, on a neighbour; the residual is what that leaves out."""
    neighbour = np.empty(len(used), dtype=np.int64)
    neighbour[faces[:, 0]] = faces[:, 1]
    neighbour[faces[:, 1]] = faces[:, 2]
    neighbour[faces[:, 2]] = faces[:, 0]
    rows = np.arange(len(used))
    weights = np.concatenate([np.full(len(used), 0.9), np.full(len(used), 0.1)])
    columns = np.concatenate([used, used[neighbour]])
    matrix = sp.csr_array((weights, (np.tile(rows, 2), columns)), shape=(len(used), len(vertices)))
    return matrix, vertices[used].copy()


def _regions(skin: FloatArray, used: IntArray, slit: IntArray, upper_start: int, mouth: float) -> Regions:
    x, y, z = skin.T
    lips = z > SIZE[2] - 12.1
    within = (np.abs(x) < 25) & lips
    corner = np.abs(np.abs(x) - 20) < 1e-9
    at_slit = np.abs(y - mouth) < GAP
    ends = within & corner & at_slit
    upper = (np.isin(used, np.arange(upper_start, upper_start + len(slit)))) | ends
    lower = np.isin(used, slit) | ends
    front = z == SIZE[2]
    upper |= front & (np.abs(x) < 21) & (np.abs(y - mouth - 4) < 1e-6)
    lower |= front & (np.abs(x) < 21) & (np.abs(y - mouth + 4) < 1e-6)
    ring = np.flatnonzero(front & (np.abs(x) < 21) & (np.abs(np.abs(y - mouth) - 4) < 1e-6))
    ring = ring[np.argsort(np.arctan2(y[ring] - mouth, x[ring]))]
    patches: dict[str, IntArray] = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for name, half in (("eye_opening", 4.0), ("eye_socket", 8.0)):
            corners = [
                int(np.argmin(np.abs(x - sign * (16 + dx)) + np.abs(y - (mouth + 16 + dy)) + np.abs(z - SIZE[2])))
                for dx, dy in ((-half, -4), (half, -4), (half, 4), (-half, 4), (0, 4), (0, -4))
            ]
            a, b, c, d, top, bottom = corners
            patches[f"{name}_{side}"] = np.array([[a, bottom, d], [bottom, top, d], [bottom, b, top], [b, c, top]])
    return Regions(
        vertices={
            "cranium": np.flatnonzero((y > SIZE[1] - 5) & (z < SIZE[2] - 3)),
            "cranium_skin": np.flatnonzero(y > mouth + 12),
            "jaw_skin": np.flatnonzero(y < mouth - 8),
            "upper_lip": np.flatnonzero(upper),
            "lower_lip": np.flatnonzero(lower),
        },
        loops={"lip_contour": ring},
        patches=patches,
        landmarks={"infradentale": int(np.argmin(np.abs(x) + np.abs(y - mouth + 4) + np.abs(z - SIZE[2])))},
    )
