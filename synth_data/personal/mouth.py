"""The ring muscle of the mouth: pursing, funnelling, pressing and rolling lips, and cheeks that are blown up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from retarget.types import FloatArray, IntArray, Regions
from synth_data.lip_contact import compliance, least, missing_gaps, sides
from synth_data.personal.frame import Frame
from synth_data.personal.shares import Skin, smoothstep

DISC = 1.05, 0.85  # extent of the oral disc beside and above the mouth, in half widths of the mouth
PLATEAU = 0.75  # share of that extent over which the disc is 1
DEPTH = 22.0  # mm behind the lips to where the disc reaches into the mouth
LIP = 5.0  # mm from where the lips meet over which rolling and pressing act
CONTACT = 3.0  # mm from where the lips meet within which they touch when pressed
MEETING, REACH = 5.0, 14.0  # mm from the lips within which they may touch, and beyond which contact moves nothing
GAP, SMOOTH = 0.06, 4.0  # mm that stay between them, and over which what parts them fades
CHEEK = 15.0  # mm, extent of a blown cheek

PURSE_NARROWS, FUNNEL_NARROWS, ROLL_NARROWS = 0.65, 0.34, 0.06  # relative shortening of the mouth
PURSE_AHEAD, FUNNEL_AHEAD, PUFF = 8.0, 7.0, 11.0  # mm outward
FUNNEL_UP, FUNNEL_DOWN = 3.6, 4.6  # mm that the lips part
SHIFT = 8.5  # mm, mouthLeft and mouthRight
SHRUG_UP, SHRUG_AHEAD = 2.6, 2.2  # mm
ROLL_IN, ROLL_OVER = 4.0, 2.6  # mm that the red lip goes in, and that the skin above follows it
PRESS = 2.6  # mm that the borders of the lips approach


@dataclass(frozen=True)
class Mouth:
    """Fields of the lips on one neutral, all (n,) unless stated; the disc is 1 on the lips and 0 away from them."""

    frame: Frame
    centre: FloatArray  # (3,) mm, the middle between the corners
    half_width: float  # mm
    disc: FloatArray
    lips: FloatArray  # 1 on the red of the lips
    inner: FloatArray  # 1 near where the lips meet
    contact: FloatArray  # 1 where the lips meet and touch
    border: FloatArray  # 1 on the vermilion border
    upper: FloatArray  # 1 on the upper lip, 0 on the lower one
    middle: FloatArray  # 1 at the midline, 0 at the corners
    cheeks: tuple[FloatArray, FloatArray]  # left and right
    sheets: tuple[IntArray, IntArray]  # triangles of the upper and the lower lip that may touch
    yielding: IntArray  # (k,) vertices that contact moves
    compliance: FloatArray  # (k, k)

    def along(self, at: FloatArray, w: dict[str, float]) -> FloatArray:
        """(n, 3) mm: how the skin at (n, 3) slides for contractions w by face unit."""
        local = self.frame.local(at - self.centre)
        narrow = PURSE_NARROWS * w["mouthPucker"] + FUNNEL_NARROWS * w["mouthFunnel"]
        narrow += ROLL_NARROWS * (w["mouthRollUpper"] + w["mouthRollLower"])
        out = np.zeros_like(at)
        out[:, 0] = -narrow * self.disc * local[:, 0] * np.exp(-0.5 * (local[:, 0] / (1.6 * self.half_width)) ** 2)
        out[:, 0] += SHIFT * (w["mouthLeft"] - w["mouthRight"]) * self.disc**0.6
        lower = 1 - self.upper
        rise = w["mouthFunnel"] * self.middle * self.lips * (FUNNEL_UP * self.upper - FUNNEL_DOWN * lower)
        rise += SHRUG_UP * w["mouthShrugUpper"] * self.disc * self.upper
        # the lower lip lifts the upper one, and follows it as long as it is pushed up
        rise += SHRUG_UP * w["mouthShrugLower"] * self.disc * (0.5 + w["mouthShrugUpper"] * lower)
        out[:, 1] = rise
        return self.frame.world(out)

    def outward(self, w: dict[str, float]) -> FloatArray:
        """(n,) mm outward from the face."""
        ahead = (PURSE_AHEAD * w["mouthPucker"] + FUNNEL_AHEAD * w["mouthFunnel"]) * self.lips * self.disc
        ahead += SHRUG_AHEAD * (w["mouthShrugUpper"] * self.upper + w["mouthShrugLower"]) * self.lips
        puffed = PUFF * w["cheekPuff"] * (self.cheeks[0] + self.cheeks[1])
        return np.asarray(ahead + puffed)

    def lip_motion(self, w: dict[str, float], press: tuple[float, float], sideness: FloatArray) -> FloatArray:
        """(n, 3) mm: rolling and pressing, which leave the surface that skin slides over.

        press is that of the left and the right half, sideness (n,) 1 on the left and 0 on the right.
        """
        pressed = press[0] * sideness + press[1] * (1 - sideness)
        upper, lower = w["mouthRollUpper"], w["mouthRollLower"]
        roll = upper * self.upper + lower * (1 - self.upper)
        towards = 1 - 2 * self.upper  # down on the upper lip, up on the lower one
        wide = 0.3 + 0.7 * self.middle
        out = np.zeros((len(self.disc), 3))
        out[:, 1] = towards * self.border * (1 - self.contact) * (ROLL_OVER * roll + PRESS * pressed) * wide
        # where the lips touch, both go in alike
        out[:, 2] = -self.inner * (ROLL_IN * (roll + self.contact * (0.5 * (upper + lower) - roll)) + pressed) * wide
        return self.frame.world(out)

    def parted(self, skin: FloatArray, contracted: float) -> FloatArray:
        """(n, 3) mm with lips that do not pass each other; the gap opens as anything is contracted, in [0, 1]."""
        at = self.frame.local(skin - self.centre)
        rows, missing = missing_gaps(at, *self.sheets, GAP * float(smoothstep(np.array(contracted / 0.2))))
        if not (missing > 0).any():
            return skin
        out = skin.copy()
        push = least(self.compliance, sp.csr_array(rows[:, self.yielding]), missing)
        out[self.yielding] += push[:, None] * self.frame.up
        return out


def mouth_of(
    vertices: FloatArray, faces: IntArray, regions: Regions, skin: Skin, frame: Frame, side_of_mouth: FloatArray
) -> Mouth:
    """The mouth of a neutral (n, 3) mm with faces (f, 3).

    side_of_mouth (n,) is 0 on the upper lip and 1 on the lower one.
    """
    corners = [frame.marks[f"cheilion_{side}"] for side in ("left", "right")]
    centre = 0.5 * (corners[0] + corners[1])
    half = 0.5 * float(np.linalg.norm(corners[0] - corners[1]))
    local = frame.local(vertices - centre)
    front = max(local[regions.landmarks["labrale_superius"], 2], local[regions.landmarks["labrale_inferius"], 2])
    depth = smoothstep((local[:, 2] - front + 2 * DEPTH + 12) / DEPTH)
    flat = np.hypot(local[:, 0] / (DISC[0] * half), local[:, 1] / (DISC[1] * half))
    disc = depth * np.exp(-0.5 * np.maximum(flat - PLATEAU, 0) ** 2 / 0.40**2)

    def near(loop: str, width: float) -> FloatArray:
        distance = cKDTree(vertices[regions.loops[loop]]).query(vertices)[0]
        return np.asarray(np.exp(-0.5 * (distance / width) ** 2))

    upper = 1 - smoothstep(side_of_mouth)
    to_lips = cKDTree(vertices[regions.vertices["lips"]]).query(vertices)[0]
    yielding = np.flatnonzero(to_lips < REACH)
    meeting = faces[to_lips[faces].max(axis=1) < MEETING]
    below = sides(skin.stiffness, regions)[meeting].mean(axis=1) > 0.5
    cheeks = []
    for side in ("left", "right"):
        middle = frame.place({"cheilion": 0.5, "supra_m2": 0.35, "inferior_malar": 0.15}, side)
        away = np.linalg.norm(vertices - middle, axis=1)
        cheeks.append(np.exp(-0.5 * (away / CHEEK) ** 2))
    return Mouth(
        frame=frame,
        centre=centre,
        half_width=half,
        disc=disc,
        lips=np.exp(-0.5 * (to_lips / 7.0) ** 2),
        inner=near("lip_inner", LIP),
        contact=near("lip_inner", CONTACT),
        border=near("lip_contour", LIP),
        upper=upper,
        middle=1 - smoothstep(np.abs(local[:, 0]) / half),
        cheeks=(cheeks[0], cheeks[1]),
        sheets=(meeting[~below], meeting[below]),
        yielding=yielding,
        compliance=compliance(skin.stiffness, skin.mass, yielding, SMOOTH),
    )
