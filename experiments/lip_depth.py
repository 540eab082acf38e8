"""How deep lips lie in each other, measured apart from what parts them."""

from __future__ import annotations

import numpy as np

from retarget.check import InvalidInput
from retarget.simulation.collisions import with_inner_sides
from retarget.simulation.penetration import Surface, inside
from retarget.types import FloatArray, IntArray, Regions

CORNER = 10.0  # mm from a corner of the mouth, on the neutral, within which skin folds into itself


class LipDepth:
    """Penetration of the visible lips of one character.

    A vertex counts if the winding number of the whole skin says that it lies inside and if it is behind the nearest
    triangle of the other lip, its hidden inner side included, so that it lies in that lip and not in a fold of its
    own; its depth is the distance to that triangle, beyond that of the neutral. Vertices near the corners of the mouth
    are left out: there a lip is inside of the cheek's fold more often than in the other lip.
    """

    def __init__(self, neutral: FloatArray, faces: IntArray, regions: Regions) -> None:
        """neutral (n, 3) mm. Raises InvalidInput where the topology has no lips or no corners of the mouth."""
        for part, names in (
            (regions.vertices, ("upper_lip", "lower_lip")),
            (regions.landmarks, ("cheilion_left", "cheilion_right")),
        ):
            for name in names:
                if name not in part:
                    raise InvalidInput(f"regions: expected {name!r} to measure how deep lips cross; it is missing.")
        corners = neutral[[regions.landmarks[f"cheilion_{side}"] for side in ("left", "right")]]
        away = np.linalg.norm(neutral[:, None] - corners[None], axis=2).min(axis=1) > CORNER
        upper, lower = (regions.vertices[name] for name in ("upper_lip", "lower_lip"))
        self._faces = faces
        whole = with_inner_sides(neutral, faces, upper, lower, regions.vertices.get("head"))
        self._sides = [
            (own[away[own]], Surface(_within(faces, other)))
            for own, other in zip((upper, lower), reversed(whole), strict=True)
        ]
        self.vertices: IntArray = np.concatenate([points for points, _ in self._sides])  # (p,)
        self._resting = np.zeros(len(self.vertices))
        self._resting = self(neutral)

    def __call__(self, skin: FloatArray) -> FloatArray:
        """(p,) mm, how deep each of `vertices` lies on skin (n, 3) mm; 0 outside."""
        depths = []
        for points, other in self._sides:
            depth = np.zeros(len(points))
            within = np.flatnonzero(inside(skin, self._faces, points))
            distance, corners, weights = other.nearest(skin, points[within])
            a, b, c = (skin[corners[:, i]] for i in range(3))
            towards = skin[points[within]] - np.einsum("kc,kci->ki", weights, skin[corners])
            behind = np.einsum("ki,ki->k", towards, np.cross(b - a, c - a)) < 0
            depth[within] = np.where(behind, distance, 0.0)
            depths.append(depth)
        deeper: FloatArray = np.maximum(np.concatenate(depths) - self._resting, 0.0)
        return deeper


def _within(faces: IntArray, part: IntArray) -> IntArray:
    """(g, 3) the faces with all corners in a set of vertices."""
    return np.ascontiguousarray(faces[np.isin(faces, part).all(axis=1)])
