"""How large the tets shall be, as a background mesh for the mesher."""

from __future__ import annotations

import numpy as np
import pyvista as pv
from scipy.spatial import cKDTree

from retarget.anatomy.distance import Surface, signed_distance
from retarget.types import FloatArray, IntArray, Regions

FINE_LOOPS = ("lip_contour", "lip_inner", "lid_margin_left", "lid_margin_right")
FINEST, LARGEST = 2.5, 10.0  # mm: edges at lips, lids and nose tip, and at vault and neck
GROWTH = 0.12  # mm of edge length per mm away from lips, lids and nose tip
INWARD = 0.8  # mm of edge length per mm under the surfaces
_AIR = 60.0  # mm: edges where no tets are kept
_GRID = 6.0  # mm
_MARGIN = 50.0  # mm that the background reaches beyond the skin


def sizing_field(skin: Surface, skull: Surface, regions: Regions) -> tuple[FloatArray, IntArray, FloatArray]:
    """Background points (p, 3) mm, tets (c, 4) and the edge length (p,) mm wanted at the points."""
    low, high = skin[0].min(axis=0) - _MARGIN, skin[0].max(axis=0) + _MARGIN
    shape = np.ceil((high - low) / _GRID).astype(int) + 1
    box = pv.ImageData(dimensions=tuple(shape), spacing=(_GRID,) * 3, origin=tuple(low))
    grid = box.to_tetrahedra()  # type: ignore[call-arg]  # its stub
    points = np.asarray(grid.points, dtype=np.float64)
    marks = [regions.loops[name] for name in FINE_LOOPS] + [[regions.landmarks["pronasale"]]]
    away, _ = cKDTree(skin[0][np.concatenate(marks)]).query(points)
    depth = np.minimum(signed_distance(skin, points), -signed_distance(skull, points))  # within the tissue
    wanted = np.minimum(FINEST + GROWTH * away, LARGEST) + np.minimum(INWARD * np.maximum(depth, 0.0), LARGEST)
    lengths = np.minimum(wanted + np.maximum(-depth - 3.0, 0.0), _AIR)
    return points, np.asarray(grid.cells.reshape(-1, 5)[:, 1:], dtype=np.int64), lengths
