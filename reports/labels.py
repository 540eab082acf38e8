"""Points of a picture with their names in columns beside it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from reports.camera import Camera
from reports.render import Image
from retarget.types import FloatArray


def labelled(axis: Axes, image: Image, camera: Camera, size: tuple[int, int], points: dict[str, FloatArray]) -> None:
    """The picture with each point and its name in a column beside it, midline names on the left."""
    axis.imshow(image)
    axis.axis("off")
    pixels = camera.project(np.array(list(points.values())), size)
    lateral = not any(not k.endswith(("_left", "(inside)")) for k in points)
    on_right = [
        "(inside)" in name or (name.endswith("_left") and (not lateral or x > size[0] / 2))
        for name, (x, _) in zip(points, pixels, strict=True)
    ]
    for side in (False, True):
        mine = sorted((i for i, right in enumerate(on_right) if right == side), key=lambda i: pixels[i, 1])
        if not mine:
            continue
        heights = np.array([pixels[i, 1] for i in mine])
        for i, y in zip(mine, _spread(heights, 30.0, size[1]), strict=True):
            x = size[0] + 12 if side else -12
            axis.plot([pixels[i, 0], x], [pixels[i, 1], y], color="0.35", linewidth=0.7, clip_on=False)
            axis.plot(*pixels[i], "o", markersize=5, color="#c1121f", markeredgecolor="white", markeredgewidth=0.6)
            name = list(points)[i].removesuffix("_left").replace("_left ", " ")
            axis.text(x, y, name, ha="left" if side else "right", va="center", fontsize=11, clip_on=False)
    axis.set_xlim(0, size[0])
    axis.set_ylim(size[1], 0)


def _spread(heights: FloatArray, gap: float, limit: float) -> FloatArray:
    """Ascending heights moved apart to at least `gap`, as near to where they were as a few passes bring them."""
    y = heights.copy()
    for _ in range(200):
        overlap = np.maximum(gap - np.diff(y), 0) / 2
        y[:-1] -= overlap
        y[1:] += overlap
    return np.clip(y, 0, limit)
