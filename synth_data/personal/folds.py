"""Folds: lines of known course across which compressed skin buckles inward, the deeper the older it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from retarget.types import FloatArray, IntArray
from synth_data.personal.frame import Frame, Place
from synth_data.personal.traits import Traits

LINES: dict[str, tuple[Place, ...]] = {
    "nasolabial": (
        {"alare": 1.12, "subnasale": -0.12},
        {"alare": 0.55, "cheilion": 0.5, "inferior_malar": 0.08, "subnasale": -0.13},
        {"cheilion": 1.22, "labrale_superius": -0.22},
    ),
    "forehead_low": ({"supraglabella": 0.9, "glabella": 0.1}, {"frontal_eminence": 0.45, "supraorbital": 0.55}),
    "forehead_high": ({"supraglabella": 1.7, "glabella": -0.7}, {"frontal_eminence": 0.85, "supraorbital": 0.15}),
    "glabella": ({"glabella": 0.85, "supraorbital": 0.15}, {"nasion": 0.5, "glabella": 0.35, "supraorbital": 0.15}),
    "nose_root": ({"nasion": 0.8, "rhinion": 0.2}, {"nasion": 0.5, "endocanthion": 0.4, "rhinion": 0.1}),
    "crow_foot": ({"exocanthion": 1.25, "endocanthion": -0.25}, {"exocanthion": 1.55, "endocanthion": -0.55}),
}
SAMPLES = 13  # along each line
ASIDE, PATCH = 7.0, 4.0  # mm from the line to the patches whose approach is measured, and the patches' extent
DEPTH, AGING = 3.6, 0.022  # mm at unit closing at 25 years, and its relative growth per year
ONSET = 0.04  # relative closing that skin bears without a fold
STEEPEST = 0.45  # of depth to width, so that no fold overhangs


@dataclass(frozen=True)
class Fold:
    """One line on one side of one neutral with s samples; it moves k vertices."""

    aside: sp.csr_array  # (s, n): mean of a patch beyond the line less that of one before it
    rest: FloatArray  # (s,) mm between both patches at rest
    across: FloatArray  # (s, 3) unit, along the skin
    vertices: IntArray  # (k,)
    along: FloatArray  # (k, s) interpolates samples
    profile: FloatArray  # (k,) across the line: -1 in its middle, positive beside it, 0 far away
    depth: float  # mm at unit closing
    deepest: float  # mm

    def __call__(self, points: FloatArray) -> FloatArray:
        """(k,) mm outward at `vertices`, for skin at (n, 3) mm."""
        apart = np.linalg.norm(np.asarray(self.aside @ points), axis=1)
        closing = np.maximum(1 - apart / self.rest - ONSET, 0.0)
        closing = closing**2 / (closing + 0.04)  # no jump in the slope where folding starts
        depth = self.deepest * np.tanh(self.depth * closing / self.deepest)
        return np.asarray((self.along @ depth) * self.profile)


def folds_of(vertices: FloatArray, normals: FloatArray, frame: Frame, traits: Traits, loose: FloatArray) -> list[Fold]:
    """The folds of a neutral (n, 3) mm with smooth normals; loose (n,) is 0 where no fold may act."""
    folds = []
    tree = cKDTree(vertices)
    spacing = np.median(tree.query(vertices, 4)[0][:, 1:].mean(axis=1)[loose > 0.5])
    width = max(traits.fold_width, 0.8 * float(spacing))  # what the mesh can show
    for name, places in LINES.items():
        gains = traits.gain(f"fold/{name}")
        for i, side in enumerate(("left", "right")):
            line = _curve(np.stack([frame.place(place, side) for place in places]))
            line = vertices[tree.query(line)[1]] * 0.5 + line * 0.5
            normal = normals[tree.query(line)[1]]
            tangent = np.gradient(line, axis=0)
            across = np.cross(normal, tangent)
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            ahead, behind = (_patches(vertices, line + sign * ASIDE * across, loose) for sign in (1, -1))
            away = sp.csr_array(ahead - behind)
            rest = np.linalg.norm(np.asarray(away @ vertices), axis=1)
            taper = np.sin(np.pi * np.linspace(0.12, 0.95, SAMPLES))
            reach = 3.5 * width
            moved = np.unique(np.concatenate(tree.query_ball_point(line, reach + 4.0))).astype(np.int64)
            moved = moved[loose[moved] > 0.01]
            offset = vertices[moved][:, None] - line
            distance2 = np.sum(offset**2, axis=2)
            step = np.linalg.norm(np.diff(line, axis=0), axis=1).mean()
            along = np.exp(-0.5 * (distance2 - distance2.min(axis=1, keepdims=True)) / step**2)
            along /= along.sum(axis=1, keepdims=True)
            x = np.einsum("ks,ksj,sj->k", along, offset, across) / width
            beyond = np.einsum("ks,ks->k", along, np.sqrt(np.maximum(distance2 - (x * width)[:, None] ** 2, 0)))
            end = np.exp(-0.5 * (np.maximum(beyond - 5.0, 0) / 3.0) ** 2)
            folds.append(
                Fold(
                    aside=away,
                    rest=rest,
                    across=across,
                    vertices=moved,
                    along=along * taper,
                    profile=-(1 - x**2) * np.exp(-0.5 * x**2) * end * loose[moved],
                    depth=gains[i] * DEPTH * (1 + AGING * max(traits.age - 25, 0)),
                    deepest=STEEPEST * width,
                )
            )
    return folds


def _curve(knots: FloatArray) -> FloatArray:
    """(SAMPLES, 3) points on the Bezier curve of two or three knots that passes through the middle one."""
    t = np.linspace(0, 1, SAMPLES)[:, None]
    if len(knots) == 2:
        return (1 - t) * knots[0] + t * knots[1]
    control = 2 * knots[1] - 0.5 * (knots[0] + knots[2])
    return (1 - t) ** 2 * knots[0] + 2 * t * (1 - t) * control + t**2 * knots[2]


def _patches(vertices: FloatArray, centres: FloatArray, loose: FloatArray) -> FloatArray:
    """(s, n) weights of means over patches about centres (s, 3) mm."""
    distance2 = cdist(centres, vertices, "sqeuclidean")
    weight = loose * np.exp(-0.5 * (distance2 - distance2.min(axis=1, keepdims=True)) / PATCH**2)
    weight[weight < 1e-4] = 0.0
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))
