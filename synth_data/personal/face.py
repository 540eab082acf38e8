"""The face of one person: weights of face units in, skin out.

The order is that of the tissue: muscles pull the skin along the surface it slides over; skin that is compressed
thickens and folds; lips roll and press, cheeks blow up; lids turn about the eyeballs; the jaw carries what is on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from retarget.check import check_faces, check_vertices
from retarget.geometry.laplacian import Heat
from retarget.geometry.triangles import areas
from retarget.types import FloatArray, IntArray, Regions
from synth_data.arkit import SKIN_NAMES
from synth_data.personal.folds import Fold, folds_of
from synth_data.personal.frame import Frame, face_frame
from synth_data.personal.jaw import Excursion, JawMotion, jaw_motion
from synth_data.personal.lids import LidAction, Lids, lids_of
from synth_data.personal.mouth import Mouth, mouth_of
from synth_data.personal.muscles import MUSCLES, Pull, pulls_of
from synth_data.personal.relaxation import Relaxation, relaxation_of
from synth_data.personal.shares import carried, skin_of, smoothstep
from synth_data.personal.sliding import Sliding, sliding_surface
from synth_data.personal.traits import Traits

STEPS = 4  # of Heun's method along the pulls
THICKEST, THINNEST = 3.5, -0.8  # mm by which tissue grows and shrinks
CHEEK = ("zygomaticus", "risorius", "buccinator", "depressor_anguli")  # muscles to the corners of the mouth
STRETCHED = 0.3  # share of their pull that cheeks stretched by a wide open jaw withstand
TAUT_PUCKER, TAUT_PAIRS = 0.45, {"mouthSmile": 0.2, "mouthStretch": 0.2, "mouthFrown": 0.2, "mouthPress": 0.5}
LINING = 16.0  # mm over which the lips and the lining of the mouth follow the skin about them
SIDES = ("left", "right")
MOUTH_UNITS = (
    "mouthPucker", "mouthFunnel", "mouthRollUpper", "mouthRollLower", "mouthLeft", "mouthRight", "mouthShrugUpper",
    "mouthShrugLower", "cheekPuff",
)  # fmt: skip


@dataclass(frozen=True)
class PersonalFace:
    """A neutral with everything that is computed once; `personal_face` makes it."""

    neutral: FloatArray  # (n, 3) mm
    faces: IntArray  # (f, 3)
    traits: Traits
    frame: Frame
    sliding: Sliding
    skin: IntArray  # vertices that keep their height over the surface
    carry: sp.csr_array  # (n, n) what the lining of the mouth takes along from the skin before it
    height: FloatArray  # (n,) mm over the surface
    pulls: Sequence[Pull]
    mouth: Mouth
    lids: tuple[Lids, Lids]  # left, right
    folds: Sequence[Fold]
    jaw: JawMotion
    relaxation: Relaxation  # of creases in which the skin would cross itself
    off_lids: FloatArray  # (n,) 0 on lids, which muscles of the cheek and brow do not drag off the eyeball
    soft: FloatArray  # (n,) 1 where compressed tissue thickens
    outside: IntArray  # triangles of the visible skin
    blur: Heat
    to_left: FloatArray  # (n,) 1 on the left half, 0 on the right

    def __call__(self, weights: FloatArray) -> FloatArray:
        """(t, n, 3) mm for weights (t, 51) of `SKIN_NAMES`; zero weights give the neutral, bit for bit."""
        return np.stack([self._frame(row) for row in np.atleast_2d(weights)])

    def _frame(self, row: FloatArray) -> FloatArray:
        if not row.any():
            return self.neutral.copy()
        w = dict(zip(SKIN_NAMES, np.clip(row, 0.0, 1.5).tolist(), strict=True))
        skin = self._slid(w)
        skin = skin + self._outward(skin, w)
        skin += self.mouth.lip_motion(w, (w["mouthPressLeft"], w["mouthPressRight"]), self.to_left)
        for side, lids in zip(("Left", "Right"), self.lids, strict=True):
            skin[lids.vertices] += lids(self.neutral, self._lid_action(w, side))
        shut = min(_closing(w) + self._taut(w), 1.0)
        excursion = Excursion(self._opening(w), w["jawForward"], w["jawLeft"], w["jawRight"], shut)
        return self.relaxation(self.mouth.parted(self.jaw(skin, excursion), max(w.values())))

    def _opening(self, w: dict[str, float]) -> float:
        return float(self.traits.response(np.array(w["jawOpen"])))

    def _taut(self, w: dict[str, float]) -> float:
        """How far lips that muscles draw tight stay together over an opening jaw."""
        drawn = [share * (w[f"{unit}Left"] + w[f"{unit}Right"]) / 2 for unit, share in TAUT_PAIRS.items()]
        return w["jawOpen"] * (TAUT_PUCKER * w["mouthPucker"] + sum(drawn))

    def _slid(self, w: dict[str, float]) -> FloatArray:
        """(n, 3) mm: muscles pull, skin keeps its height over the surface."""
        stretched = 1 - STRETCHED * self._opening(w)
        contracted = [self._contraction(pull, w) * (stretched if pull.name in CHEEK else 1.0) for pull in self.pulls]
        active = [(pull, c) for pull, c in zip(self.pulls, contracted, strict=True) if c > 0]
        at = self.neutral.copy()
        units = self._ring(w)
        if not active and not any(units.values()):
            return at
        for _ in range(STEPS):
            first = self._velocity(at, active, units)
            second = self._velocity(at + first / STEPS, active, units)
            at += 0.5 * (first + second) / STEPS
            moving = self.skin[np.abs(first[self.skin]).max(axis=1) > 1e-4]
            height, normal = self.sliding(at[moving])
            lift = np.zeros_like(at)
            lift[moving] = (self.height[moving] - height)[:, None] * normal
            at += np.asarray(self.carry @ lift)
        return at

    def _velocity(self, at: FloatArray, active: list[tuple[Pull, float]], units: dict[str, float]) -> FloatArray:
        total = self.mouth.along(at, units)
        together = strongest = np.linalg.norm(total, axis=1)
        for pull, contraction in active:
            velocity = pull.velocity(at, contraction)
            speed = contraction * pull.length * pull.reach
            together, strongest = together + speed, np.maximum(strongest, speed)
            total += velocity
        total *= (self.off_lids / (1 + (together - strongest) / self.traits.stiffening))[:, None]
        speed = np.linalg.norm(total, axis=1) / self.traits.stiffening
        return np.asarray(total / (1 + speed**4)[:, None] ** 0.25)

    def _outward(self, skin: FloatArray, w: dict[str, float]) -> FloatArray:
        """(n, 3) mm: thickening, folds, protruding lips and blown cheeks."""
        moved = np.abs(skin - self.neutral).max(axis=1) > 1e-4
        out = self.mouth.outward(self._ring(w)) * self.off_lids
        if moved.any():
            out += self._thickening(skin)
            for fold in self.folds:
                out[fold.vertices] += fold(skin)
        at = np.flatnonzero(out)
        pushed = np.zeros_like(skin)
        if len(at):
            pushed[at] = out[at, None] * self.sliding(skin[at])[1]
        return np.asarray(self.carry @ pushed)

    def _thickening(self, skin: FloatArray) -> FloatArray:
        """(n,) mm by which the tissue grows where area shrinks: thickness times area is kept."""
        triangles = self.faces[self.outside]
        before, after = (
            self.blur(np.bincount(triangles.ravel(), np.repeat(areas(v, triangles), 3), len(skin)) / self.blur.mass)
            for v in (self.neutral, skin)
        )
        grown = self.traits.thickness * (before / np.maximum(after, 0.2 * before + 1e-9) - 1)
        limited = np.where(grown > 0, THICKEST * np.tanh(grown / THICKEST), -THINNEST * np.tanh(-grown / THINNEST))
        return np.asarray(self.soft * limited)

    def _contraction(self, pull: Pull, w: dict[str, float]) -> float:
        muscle = MUSCLES[pull.name]
        total = 0.0
        for unit, share in muscle.units.items():
            weight = w[unit] if unit in w else w[unit + pull.side.title()]
            total += share * float(self.traits.response(np.array(weight)))
        return total

    def _ring(self, w: dict[str, float]) -> dict[str, float]:
        """Contractions of the mouth's ring muscle with the person's gains."""
        units = {}
        for name in MOUTH_UNITS:
            if name in ("mouthLeft", "mouthRight"):
                gain = self.traits.gain("mouthSide")[SIDES.index(name.removeprefix("mouth").lower())]
            else:
                gain = float(np.sqrt(np.prod(self.traits.gain(name))))
            units[name] = gain * float(self.traits.response(np.array(w[name])))
        return units

    def _lid_action(self, w: dict[str, float], side: str) -> LidAction:
        blink, squint, down = min(w[f"eyeBlink{side}"], 1.0), w[f"eyeSquint{side}"], w[f"eyeLookDown{side}"]
        lower = self.traits.gain("lid/lower")[SIDES.index(side.lower())]
        brow = 0.06 * w[f"browDown{side}"]
        still_open = (1 - blink) * (1 - 0.30 * squint) * (1 - 0.42 * down) * (1 - brow)
        raised = lower * (0.10 * blink + 0.32 * squint + 0.22 * w[f"cheekSquint{side}"] + 0.12 * w[f"mouthSmile{side}"])
        return LidAction(
            shut=1 - max(still_open, 0.0),
            lower=min(raised, 0.5),
            wide=w[f"eyeWide{side}"] * (1 - blink),
            up=w[f"eyeLookUp{side}"] * (1 - blink),
            down=down * (1 - blink),
            aside=(w[f"eyeLookOut{side}"] - w[f"eyeLookIn{side}"]) * (1 if side == "Left" else -1) * (1 - blink),
        )


def _closing(w: dict[str, float]) -> float:
    """How far mouthClose keeps the lips together over an opening jaw: in full where it is equal to jawOpen.

    That is what ARKit's units mean, whose mouthClose takes back what jawOpen of the same weight does to the lips.
    """
    return min(w["mouthClose"] / w["jawOpen"], 1.0) if w["jawOpen"] else 0.0


def personal_face(vertices: FloatArray, faces: IntArray, regions: Regions, traits: Traits) -> PersonalFace:
    """Everything that is computed once for a neutral (n, 3) mm with faces (f, 3).

    Needs the regions, loops, landmarks and points that docs/regions.md lists. Raises InvalidInput for arrays that do
    not fit each other.
    """
    vertices = check_vertices("neutral", vertices)
    faces = check_faces("faces", faces, len(vertices))
    n = len(vertices)
    skin, frame = skin_of(vertices, faces), face_frame(vertices, regions)
    jaw = jaw_motion(vertices, regions, skin, frame, traits)
    visible = regions.vertices["head"]
    sliding = sliding_surface(vertices, faces, skin, np.setdiff1d(visible, regions.vertices["ears"]))
    lids = [lids_of(vertices, faces, regions, skin, frame, side) for side in SIDES]
    on_lids = np.zeros(n)
    for lid in lids:
        on_lids[lid.vertices] = np.maximum(on_lids[lid.vertices], np.minimum(lid.upper + lid.lower, 1.0))
    for part in lids:
        inner = np.setdiff1d(np.arange(n), visible)
        near = inner[np.linalg.norm(vertices[inner] - part.centre, axis=1) < 1.5 * part.radius]
        on_lids[near] = 1.0
    off_lids = 1 - smoothstep(1.4 * on_lids)
    mouth = mouth_of(vertices, faces, regions, skin, frame, jaw.share)
    outer = np.setdiff1d(visible, regions.vertices["lips"])
    behind = np.setdiff1d(np.arange(n), outer)
    height, normals = sliding(vertices)
    lips = np.zeros(n)
    lips[regions.vertices["lips"]] = 1.0
    face_part = np.zeros(n)
    face_part[regions.vertices["face"]] = 1.0
    soft = skin.blurred(face_part, 4.0) * off_lids * (1 - 0.6 * skin.blurred(lips, 2.0)) * (1 - mouth.inner)
    bends = (jaw.share > 0.1) & (jaw.share < 0.9)
    nose = np.zeros(n)
    nose[regions.vertices["nose"]] = 1.0
    loose = off_lids * smoothstep(1 - 1.2 * skin.blurred(lips, 1.5))
    across = frame.local(vertices - 0.5 * (frame.marks["nasion"] + frame.marks["pogonion"]))[:, 0]
    return PersonalFace(
        neutral=vertices,
        faces=faces,
        traits=traits,
        frame=frame,
        sliding=sliding,
        skin=outer,
        carry=carried(vertices, outer, behind, LINING, mouth.upper),
        height=height,
        pulls=pulls_of(vertices, frame, traits, jaw.share),
        mouth=mouth,
        lids=(lids[0], lids[1]),
        folds=folds_of(vertices, normals, frame, traits, loose),
        jaw=jaw,
        relaxation=relaxation_of(vertices, faces, skin.mass, np.flatnonzero(lips + on_lids + bends)),
        off_lids=off_lids,
        soft=soft * (1 - 0.7 * skin.blurred(nose, 3.0)),
        outside=np.flatnonzero(np.isin(faces, visible).all(axis=1)),
        blur=skin.blur(4.0),
        to_left=smoothstep(0.5 + across / 30.0),
    )
