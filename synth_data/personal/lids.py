"""Lids that turn about the eyeball: the sphere of the socket and the axis through both corners of the eye."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from retarget.geometry.graph import components, vertex_adjacency
from retarget.types import FloatArray, IntArray, Regions
from synth_data.personal.contact import Contact, rest
from synth_data.personal.frame import Frame
from synth_data.personal.shares import Skin, smoothstep

SLIT = 0.25  # mm that stay open between shut lids, so that they touch without crossing
WIDE, UP, DOWN = 0.16, 0.10, 0.10  # radians: lids of a stare, of the upper lid when looking up, of the lower when down
GAZE = np.radians((35.0, 25.0, 30.0))  # turns of the eyeball: aside, up and down
CORNEA, CORNEA_WIDE, DRAG = 0.8, 0.42, 0.12  # mm that it stands out, its extent in radians, share of a turn lids follow
MERIDIANS = 41
SHAPE = 0.8  # exponent of the shares: below 1 the lid moves as a plate and folds near the orbit


@dataclass(frozen=True)
class LidAction:
    """How far the lids of one eye are moved, each in [0, 1]."""

    shut: float = 0.0  # share of the opening that is closed
    lower: float = 0.0  # share of the opening by which the lower lid rises, at most 0.6
    wide: float = 0.0
    up: float = 0.0
    down: float = 0.0
    aside: float = 0.0  # of the gaze, in [-1, 1], towards the person's left


@dataclass(frozen=True)
class Lids:
    """The lids of one eye. Angles are about the axis, 0 straight ahead and positive upward."""

    centre: FloatArray  # (3,) mm of the eyeball
    radius: float  # mm
    axes: FloatArray  # (3, 3) rows: along the corners, up, ahead
    vertices: IntArray  # (m,) that move
    upper: FloatArray  # (m,) share in the upper lid's turn
    lower: FloatArray  # (m,)
    opening: FloatArray  # (m,) radians between the lids on each vertex's meridian
    rims: tuple[IntArray, IntArray]  # rows of `vertices` on the upper and the lower rim, which meet
    contact: Contact
    crease: FloatArray  # (m,) mm by which lid skin stands off the sphere that its margin moves on
    leftward: float  # 1 where the first axis points to the person's left, else -1

    def __call__(self, neutral: FloatArray, action: LidAction) -> FloatArray:
        """(m, 3) mm: displacement of `vertices` of the neutral (n, 3)."""
        at = (neutral[self.vertices] - self.centre) @ self.axes.T
        radius, angle = np.hypot(at[:, 1], at[:, 2]), np.arctan2(at[:, 1], at[:, 2])
        rise = np.minimum(action.lower, 0.6) * self.opening
        drop = action.shut * (self.opening - rise)
        fade = smoothstep(self.opening / 0.3)  # towards the corners
        turn = self.upper * ((WIDE * action.wide + UP * action.up) * fade - drop)
        turn += self.lower * (rise - (0.5 * WIDE * action.wide + DOWN * action.down) * fade)
        unfolded = radius - 0.6 * self.upper * action.shut * self.crease
        angle = angle + turn
        sheets = [(np.column_stack([at[rim, 0], unfolded[rim]]), (radius * angle)[rim]) for rim in self.rims]
        for rim, (plane, _), push in zip(self.rims, sheets, self.contact(*sheets), strict=True):
            if push.any():
                share = self.upper if rim is self.rims[0] else self.lower
                angle += _fade(np.column_stack([at[:, 0], unfolded]), plane, push) * share / radius
        moved = np.column_stack([at[:, 0], unfolded * np.sin(angle), unfolded * np.cos(angle)])
        if action.aside or action.up or action.down:
            moved += self._looking(moved, action)
        return (moved - at) @ self.axes

    def _looking(self, at: FloatArray, action: LidAction) -> FloatArray:
        """(m, 3) mm along the axes: lids that ride on the cornea, which turns with the gaze and drags them along."""
        aside = GAZE[0] * action.aside * self.leftward
        up = GAZE[1] * action.up - GAZE[2] * action.down
        distance = np.linalg.norm(at, axis=1, keepdims=True)
        direction = at / distance
        ahead, gaze = (
            np.array([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)]) for x, y in ((0.0, 0.0), (aside, up))
        )
        out = [np.exp(-0.5 * (np.arccos(np.clip(direction @ to, -1, 1)) / CORNEA_WIDE) ** 2) for to in (ahead, gaze)]
        on_lid = np.minimum(self.upper + self.lower, 1.0)
        dragged = DRAG * aside * distance[:, 0] * direction[:, 2] * smoothstep(self.opening / 0.3)
        ride = (on_lid * CORNEA * (out[1] - out[0]))[:, None] * direction
        ride[:, 0] += on_lid * dragged
        return np.asarray(ride)


def lids_of(vertices: FloatArray, faces: IntArray, regions: Regions, skin: Skin, frame: Frame, side: str) -> Lids:
    """The lids of the "left" or "right" eye of a neutral (n, 3) mm."""
    margin = regions.loops[f"lid_margin_{side}"]
    upper, lower = regions.vertices[f"lid_margin_upper_{side}"], regions.vertices[f"lid_margin_lower_{side}"]
    socket, rim = _socket_and_rim(vertices, faces, regions, side)
    centre, radius = fit_sphere(vertices[socket])
    along = frame.marks[f"exocanthion_{side}"] - frame.marks[f"endocanthion_{side}"]
    along /= np.linalg.norm(along)
    ahead = vertices[margin].mean(axis=0) - centre
    ahead -= (ahead @ along) * along
    ahead /= np.linalg.norm(ahead)
    up = np.cross(ahead, along)
    axes = np.stack([along, up * np.sign(up @ frame.up), ahead])

    at = (vertices - centre) @ axes.T
    distance, angle = np.hypot(at[:, 1], at[:, 2]), np.arctan2(at[:, 1], at[:, 2])
    nearest = cKDTree(vertices[np.concatenate([upper, lower])]).query(vertices[rim])[1]
    above = np.union1d(rim[nearest < len(upper)], upper)
    below = np.union1d(rim[nearest >= len(upper)], lower)
    grid = np.linspace(at[margin, 0].min(), at[margin, 0].max(), MERIDIANS)
    window = 0.03 * (grid[-1] - grid[0])
    low = _envelope(grid, at[above, 0], angle[above], window)
    high = -_envelope(grid, at[below, 0], -angle[below], window)
    front = [np.interp(grid, *_by_place(at[lid, 0], angle[lid])) for lid in (_with_corners(margin, upper, lower))]
    # the rims stand before or behind the margins, so they touch while the margins are still apart
    half = slice(MERIDIANS // 4, -(MERIDIANS // 4))
    kept = np.median((low - high - SLIT / radius)[half] / np.maximum(front[0] - front[1], 1e-3)[half])
    gap = np.clip(kept, 0.0, 1.0) * np.maximum(front[0] - front[1], 0.0)

    deep = socket[at[socket, 2] < 0.6 * radius]
    fixed = np.full(len(vertices), 0.0)
    fixed[np.concatenate([regions.vertices[f"eye_{side}"], socket])] = np.nan
    fixed[np.concatenate([regions.loops[f"eye_socket_{side}"], deep])] = 0.0
    shares = []
    for moving, still in ((above, below), (below, above)):
        values = fixed.copy()
        values[still], values[moving] = 0.0, 1.0
        share = skin.harmonic(values)
        shares.append(np.where(np.isin(np.arange(len(vertices)), moving), 1.0, share**SHAPE))
    moved = np.flatnonzero(shares[0] + shares[1] > 0)
    rims = np.searchsorted(moved, above), np.searchsorted(moved, below)
    sheets = [(np.column_stack([at[rim, 0], distance[rim]]), (distance * angle)[rim]) for rim in (above, below)]
    order = np.argsort(at[upper, 0])
    on_margin = np.interp(at[moved, 0], at[upper[order], 0], distance[upper[order]])
    return Lids(
        centre=centre,
        radius=radius,
        axes=axes,
        vertices=moved,
        upper=shares[0][moved],
        lower=shares[1][moved],
        opening=np.interp(at[moved, 0], grid, gap),
        rims=rims,
        contact=rest(sheets[0], sheets[1], SLIT),
        crease=np.maximum(distance[moved] - on_margin, 0.0),
        leftward=float(np.sign(axes[0] @ frame.left)),
    )


def _fade(plane: FloatArray, rim: FloatArray, push: FloatArray) -> FloatArray:
    """(m,) mm: the push (k,) of a rim's vertices (k, 2) carried to those at (m, 2), of whom the nearest counts."""
    return np.asarray(push[cKDTree(rim).query(plane)[1]])


def fit_sphere(points: FloatArray) -> tuple[FloatArray, float]:
    """Centre (3,) and radius of the sphere through points (m, 3), by linear least squares."""
    middle = points.mean(axis=0)
    away = points - middle
    solution = np.linalg.lstsq(np.column_stack([2 * away, np.ones(len(away))]), (away**2).sum(axis=1), rcond=None)[0]
    return middle + solution[:3], float(np.sqrt(solution[3] + solution[:3] @ solution[:3]))


def _socket_and_rim(vertices: FloatArray, faces: IntArray, regions: Regions, side: str) -> tuple[IntArray, IntArray]:
    """The vertices behind the lids, and those of the rims between the margins and the socket."""
    margin, inside = (
        regions.loops[f"lid_margin_{side}"],
        np.setdiff1d(np.arange(len(vertices)), regions.vertices["head"]),
    )
    adjacency = vertex_adjacency(faces, len(vertices))
    parts = [inside[part] for part in components(adjacency[inside][:, inside])]
    eye = vertices[margin].mean(axis=0)
    socket = min(parts, key=lambda part: float(np.linalg.norm(vertices[part].mean(axis=0) - eye)))
    skin = np.setdiff1d(regions.vertices[f"eye_{side}"], margin)
    rims = [
        skin[part]
        for part in components(adjacency[skin][:, skin])
        if not np.isin(skin[part], regions.loops[f"eye_socket_{side}"]).any()
    ]
    return socket, np.concatenate(rims)


def _with_corners(margin: IntArray, upper: IntArray, lower: IntArray) -> tuple[IntArray, IntArray]:
    """The upper and the lower half of the margin, each with both corners."""
    return np.setdiff1d(margin, lower), np.setdiff1d(margin, upper)


def _by_place(place: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    order = np.argsort(place)
    return place[order], value[order]


def _envelope(grid: FloatArray, place: FloatArray, angle: FloatArray, window: float) -> FloatArray:
    """The lowest angle near each place of the grid, smoothed."""
    apart = np.abs(grid[:, None] - place)
    near = apart <= np.maximum(window, apart.min(axis=1, keepdims=True))
    lowest = np.where(near, angle, np.inf).min(axis=1)
    weight = np.exp(-0.5 * ((grid[:, None] - grid) / window) ** 2)
    return np.asarray(weight @ lowest / weight.sum(axis=1))
