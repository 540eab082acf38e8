"""The mandible: rotation about the axis through both condyles, which glide forward, and the share of the skin in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from retarget.types import FloatArray, Regions
from synth_data.personal.frame import Frame
from synth_data.personal.shares import Skin, carried
from synth_data.personal.traits import REFERENCE_MANDIBLE, Traits

OVAL = 2.5  # the parting of the lips falls off as 1 - |x|^OVAL towards the corners
SHUT = 0.5  # share of all of both lips when they stay shut over an opening jaw
BLUR = 5.0  # mm
THROAT = 16.0  # mm, of the blur below the jaw, where the skin folds least over the throat
CLING = 1.0  # how far lips that touch move alike when the jaw shifts
LINING = 9.0  # mm above and below the corners beyond which the lining of the mouth follows the skin before it
NOSE = 11.0  # mm about the nose that stay with it


@dataclass(frozen=True)
class Excursion:
    """What a jaw does, each in [0, 1] of the person's own range; `shut` keeps the lips together meanwhile."""

    opening: float = 0.0
    forward: float = 0.0
    left: float = 0.0
    right: float = 0.0
    shut: float = 0.0


@dataclass(frozen=True)
class JawMotion:
    """How the skin follows the jaw of one person."""

    share: FloatArray  # (n,) of the jaw's motion, lips free
    shut: FloatArray  # (n,) of the jaw's motion, lips shut
    centre: FloatArray  # (3,) mm, the middle between the condyles
    frame: Frame
    angle: float  # radians at full opening
    length: float  # mm from the condyles' axis to the incisors
    glide: float  # mm, and so are the rest
    protrusion: float
    left: float
    right: float

    def __call__(self, points: FloatArray, excursion: Excursion) -> FloatArray:
        """(n, 3) mm: points carried along arcs, each by its share of the rotation and of the translation."""
        share = self.share + excursion.shut * (self.shut - self.share)
        dragged = share + CLING * (1 - excursion.opening) * (self.shut - share)  # lips that touch drag each other along
        aside = excursion.left * self.left - excursion.right * self.right
        turn = share[:, None] * (self.angle * excursion.opening) * self.frame.left
        turn += dragged[:, None] * (aside / self.length) * self.frame.up
        ahead = share * (self.glide * excursion.opening) + dragged * (self.protrusion * excursion.forward)
        return (
            self.centre + Rotation.from_rotvec(turn).apply(points - self.centre) + ahead[:, None] * self.frame.forward
        )


def jaw_motion(vertices: FloatArray, regions: Regions, skin: Skin, frame: Frame, traits: Traits) -> JawMotion:
    """The jaw of a neutral (n, 3) mm: axis through its condyles, excursions scaled with its mandible."""
    condyles = [regions.points[f"condyle_{side}"](vertices) for side in ("left", "right")]
    centre = 0.5 * (condyles[0] + condyles[1])
    incisors = frame.marks["infradentale"] - 10.0 * frame.forward  # teeth stand behind the lip's thickness
    arm = frame.local(incisors - centre)[1:]
    length = float(np.linalg.norm(arm))
    size = length / REFERENCE_MANDIBLE
    jaw = traits.jaw
    return JawMotion(
        share=_share(vertices, regions, skin, frame, shut=False),
        shut=_share(vertices, regions, skin, frame, shut=True),
        centre=centre,
        frame=frame,
        angle=2 * float(np.arcsin(jaw.opening / (2 * REFERENCE_MANDIBLE))),
        length=length,
        glide=size * jaw.glide,
        protrusion=size * jaw.protrusion,
        left=size * jaw.left,
        right=size * jaw.right,
    )


def _share(vertices: FloatArray, regions: Regions, skin: Skin, frame: Frame, shut: bool) -> FloatArray:
    """(n,) 0 on the cranium, the nose, the ears and the end of the neck, 1 on the chin, harmonic between."""
    values = np.full(len(vertices), np.nan)
    for name in ("cranium_skin", "nose", "ears", "scalp", "neck_boundary"):
        values[regions.vertices[name]] = 0.0
    around = cKDTree(vertices[regions.vertices["nose"]]).query(vertices[regions.vertices["head"]])[0] < NOSE
    values[regions.vertices["head"][around]] = 0.0
    left, right = (frame.marks[f"cheilion_{side}"] for side in ("left", "right"))
    middle, half = 0.5 * (left + right), 0.5 * float((left - right) @ frame.left)
    jaw = regions.vertices["jaw_skin"]
    across = np.abs((vertices[jaw] - middle) @ frame.left) / half
    values[jaw[across < 1.1]] = 1.0
    for name, rest in (("upper_lip", 0.04), ("lower_lip", 0.96)):
        lip = regions.vertices[name]
        across = np.minimum(np.abs((vertices[lip] - middle) @ frame.left) / half, 1.0) ** OVAL
        values[lip] = SHUT if shut else (1 - across) * rest + across * 0.45
    first = skin.harmonic(values, BLUR)
    inner = np.setdiff1d(np.arange(len(vertices)), regions.vertices["head"])
    inner = inner[np.abs((vertices[inner] - middle) @ frame.up) > LINING]
    taken = np.asarray(carried(vertices, regions.vertices["head"], inner, np.inf, first)[inner] @ first)
    near = cKDTree(vertices[regions.vertices["head"]]).query(vertices[inner])[0] < 1.5 * LINING
    values[inner[near]] = taken[near]
    share = skin.harmonic(values, BLUR)
    below = np.isin(np.arange(len(vertices)), regions.vertices["neck"]).astype(np.float64)
    return np.asarray(share + skin.blurred(below, THROAT) * (skin.blurred(share, THROAT) - share))
