"""Which part of the skull moves with the cranium and which with the jaw."""

from __future__ import annotations

import numpy as np

from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray, Regions

GAP = 6.0  # mm between cranium and jaw that follow neither


def label_bones(skin: FloatArray, regions: Regions, vertices: FloatArray, skull: IntArray) -> tuple[IntArray, IntArray]:
    """Sorted indices of cranium and jaw among the skull vertices `skull` of vertices (m, 3) mm.

    The jaw lies below the plane through jaw joints and mouth corners, and before the line from the joints to the jaw
    angles; the cranium lies above or behind. Both planes hold the axis of the joints, hence they are the same for
    every pose of one head. Raises InvalidInput if either bone is empty.
    """
    joint, mouth, angle = _midpoints(skin, regions)
    axis = regions.points["condyle_left"](skin) - regions.points["condyle_right"](skin)
    below = _normal(axis, mouth - joint)  # downward, off the bite plane
    before = -_normal(axis, angle - joint)  # forward, off the back of the ramus
    offsets = vertices[skull] - joint
    depth = np.minimum(offsets @ below, offsets @ before)
    jaw, cranium = skull[depth > GAP / 2], skull[depth < -GAP / 2]
    if len(jaw) == 0 or len(cranium) == 0:
        raise InvalidInput(
            f"skull: expected a cranium and a jaw, got {len(cranium)} and {len(jaw)} vertices; check the landmarks "
            "cheilion and gonion and the points condyle of the regions."
        )
    return np.sort(cranium), np.sort(jaw)


def _midpoints(skin: FloatArray, regions: Regions) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(3,) mm between the jaw joints, the mouth corners and the jaw angles."""
    joint = 0.5 * (regions.points["condyle_left"](skin) + regions.points["condyle_right"](skin))
    mouth, angle = (
        0.5 * (skin[regions.landmarks[f"{name}_left"]] + skin[regions.landmarks[f"{name}_right"]])
        for name in ("cheilion", "gonion")
    )
    return joint, mouth, angle


def _normal(axis: FloatArray, direction: FloatArray) -> FloatArray:
    """(3,) unit normal of the plane that holds both."""
    normal = np.cross(axis, direction)
    unit: FloatArray = normal / np.linalg.norm(normal)
    return unit
