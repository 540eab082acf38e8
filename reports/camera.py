"""Cameras for figures: where a head is seen from, and where its points land in the picture.

All heads of one figure share one camera, so that their sizes compare.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from retarget.check import InvalidInput
from retarget.types import FloatArray

FIELD_OF_VIEW = 14.0  # degrees, vertical: a portrait lens, so that noses do not grow


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. eye and target are (x, y, z) in mm, +y is up; `field_of_view` is vertical, in degrees."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    field_of_view: float = FIELD_OF_VIEW

    @property
    def axes(self) -> FloatArray:
        """(3, 3) rows: right, up, backward (towards the viewer)."""
        backward = np.subtract(self.eye, self.target)
        return _axes(backward / np.linalg.norm(backward))

    def rays(self, size: tuple[int, int], samples: int = 1) -> tuple[FloatArray, FloatArray]:
        """Origin (3,) mm and unit directions (h * samples, w * samples, 3), one through each sub-pixel centre.

        size is (width, height) in pixels.
        """
        width, height = size[0] * samples, size[1] * samples
        tangent = np.tan(np.radians(self.field_of_view) / 2)
        x = (2 * (np.arange(width) + 0.5) / width - 1) * tangent * width / height
        y = (1 - 2 * (np.arange(height) + 0.5) / height) * tangent
        directions = np.stack([*np.meshgrid(x, y), np.full((height, width), -1.0)], axis=-1) @ self.axes
        return np.array(self.eye), directions / np.linalg.norm(directions, axis=-1, keepdims=True)

    def project(self, points: ArrayLike, size: tuple[int, int]) -> FloatArray:
        """Pixels (m, 2), x to the right and y down from the upper left corner, of points (m, 3) mm."""
        local = (np.asarray(points, dtype=np.float64) - self.eye) @ self.axes.T
        half_height = -local[:, 2] * np.tan(np.radians(self.field_of_view) / 2)
        x = local[:, 0] / half_height * size[1] / 2 + size[0] / 2
        y = size[1] / 2 - local[:, 1] / half_height * size[1] / 2
        return np.column_stack([x, y])


def look(
    vertices: ArrayLike, size: tuple[int, int], turn: float = 0.0, raise_: float = 0.0, margin: float = 0.04
) -> Camera:
    """The camera that just holds vertices (..., 3) mm, all of them, in a picture of size (width, height) pixels.

    turn is the angle in degrees by which the viewer walks round the head towards its left side (+x), raise_ the angle
    above the horizon, margin the empty share of the picture at each side.
    """
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    if len(points) == 0:
        raise InvalidInput("vertices: expected at least one to aim the camera at, got none.")
    a, b = np.radians(turn), np.radians(raise_)
    backward = np.array([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)])
    axes = _axes(backward)
    local = points @ axes.T
    tangent_y = np.tan(np.radians(FIELD_OF_VIEW) / 2) * (1 - 2 * margin)
    tangent_x = tangent_y * size[0] / size[1]
    # |x - cx| <= (cz - z) tangent: the frustum's sides meet at the eye, so each axis gives a centre and a distance.
    centre, distance = np.zeros(2), np.zeros(2)
    for axis, tangent in enumerate((tangent_x, tangent_y)):
        upper = np.max(local[:, axis] + local[:, 2] * tangent)
        lower = np.min(local[:, axis] - local[:, 2] * tangent)
        centre[axis], distance[axis] = (upper + lower) / 2, (upper - lower) / 2 / tangent
    depth = float(np.mean([local[:, 2].min(), local[:, 2].max()]))
    eye = np.array([*centre, distance.max()]) @ axes
    target = np.array([*centre, depth]) @ axes
    return Camera(eye=(eye[0], eye[1], eye[2]), target=(target[0], target[1], target[2]))


def front(vertices: ArrayLike, size: tuple[int, int], margin: float = 0.04) -> Camera:
    """From the front; see `look`."""
    return look(vertices, size, margin=margin)


def three_quarter(vertices: ArrayLike, size: tuple[int, int], margin: float = 0.04) -> Camera:
    """From the head's front left, slightly above; see `look`."""
    return look(vertices, size, turn=32.0, raise_=6.0, margin=margin)


def side(vertices: ArrayLike, size: tuple[int, int], margin: float = 0.04) -> Camera:
    """From the head's left; see `look`."""
    return look(vertices, size, turn=90.0, margin=margin)


def _axes(backward: FloatArray) -> FloatArray:
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(backward, right), backward])
