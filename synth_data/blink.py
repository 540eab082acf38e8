"""Blinks that close: whatever the shape of the eyes, each upper lid margin comes to rest on the lower one."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator

from retarget.types import FloatArray, IntArray, Regions

OVERLAP = 0.3  # mm that the upper margin passes the lower one; MakeHuman's own blink passes it by 3
CORNER = 4.0  # mm from the eye's corners over which the overlap grows


def close_lids(blink: FloatArray, neutral: FloatArray, base: FloatArray, regions: Regions, side: str) -> FloatArray:
    """The displacements (n, 3) mm of a blink of one side ("left" or "right"), corrected so that the lids meet.

    neutral (n, 3) is the identity, base (n, 3) the head on which distances between vertices are measured. The
    correction is exact at the upper margin and fades over the lid as the blink itself does.
    """
    upper, lower = _margins(regions, side)
    moved = correction_at_margin(neutral + blink, upper, lower)
    rim = np.concatenate([upper, lower])
    values = np.zeros((len(rim), 4))
    values[: len(upper), :3] = moved
    values[:, 3] = np.linalg.norm(blink[rim], axis=1)
    moving = np.flatnonzero(np.linalg.norm(blink, axis=1) > 0)
    near = RBFInterpolator(base[rim], values, kernel="linear", degree=0)(base[moving])
    share = np.linalg.norm(blink[moving], axis=1) / np.maximum(near[:, 3], 1.0)
    out = blink.copy()
    out[moving] += np.clip(share, 0, 1)[:, None] * near[:, :3]
    out[upper] = blink[upper] + moved
    return out


def correction_at_margin(vertices: FloatArray, upper: IntArray, lower: IntArray) -> FloatArray:
    """(m, 3) mm from each vertex of the upper margin to where it rests on the lower one.

    lower holds the lower margin and, at its ends, both corners of the eye; the correction is perpendicular to the
    line through the corners.
    """
    inner, outer = vertices[lower[[0, -1]]]
    along = (outer - inner) / np.linalg.norm(outer - inner)
    up = np.array([0.0, 1.0, 0.0]) - along[1] * along
    up /= np.linalg.norm(up)
    axes = np.stack([along, up, np.cross(along, up)])
    at, rest = ((vertices[rim] - inner) @ axes.T for rim in (upper, lower))
    rest = rest[np.argsort(rest[:, 0])]
    here = np.stack([np.interp(at[:, 0], rest[:, 0], rest[:, i]) for i in (1, 2)], axis=1)
    to_corner = np.minimum(at[:, 0], rest[-1, 0] - at[:, 0])
    here[:, 0] -= OVERLAP * np.clip(to_corner / CORNER, 0, 1)
    return (here - at[:, 1:]) @ axes[1:]


def _margins(regions: Regions, side: str) -> tuple[IntArray, IntArray]:
    """The upper margin without corners, and the lower one from corner to corner."""
    loop = regions.loops[f"lid_margin_{side}"]
    above = np.isin(loop, regions.vertices[f"lid_margin_upper_{side}"])
    start = int(np.flatnonzero(above & ~np.roll(above, 1))[0])
    loop, count = np.roll(loop, -start), int(above.sum())
    return loop[:count], loop[count:]
