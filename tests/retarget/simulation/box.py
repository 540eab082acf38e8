"""Box meshes of tetrahedra."""

from __future__ import annotations

import numpy as np

from retarget.types import FloatArray, IntArray


def box(cells: tuple[int, int, int], size: tuple[float, float, float]) -> tuple[FloatArray, IntArray]:
    """A box of size mm with its corner at the origin, each cell cut into six tets along one diagonal (Kuhn 1960)."""
    axes = [np.linspace(0, length, count + 1) for length, count in zip(size, cells, strict=True)]
    vertices = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape([count + 1 for count in cells])
    tets = []
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        corner = np.zeros(3, dtype=int)
        path = []
        for axis in (None, *order):
            if axis is not None:
                corner[axis] = 1
            path.append(index[tuple(slice(c, c + count) for c, count in zip(corner, cells, strict=True))].ravel())
        odd = order in ((0, 2, 1), (2, 1, 0), (1, 0, 2))
        tets.append(np.stack([path[i] for i in ((0, 2, 1, 3) if odd else (0, 1, 2, 3))], axis=1))
    return vertices, np.concatenate(tets)
