"""Facial muscles as lines from an insertion in the skin to an origin on the bone (Waters 1987, linear muscles).

A muscle that contracts pulls the skin about its insertion along the line. The pull is strongest at the insertion, fades
to nothing at the origin, and fades beside and beyond the line as a Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from retarget.types import FloatArray
from synth_data.personal.frame import Frame, Place
from synth_data.personal.shares import smoothstep
from synth_data.personal.traits import INSERTION_MM, ORIGIN_MM, Traits


@dataclass(frozen=True)
class Muscle:
    """A pair of muscles, left and right. Ends are affine combinations of landmarks."""

    units: dict[str, float]  # the face units that contract it, without side, and how far
    insertion: Place
    origin: Place
    strain: float  # shortening at full contraction as a share of its length
    width: float  # mm beside the line
    beyond: float  # mm beyond the insertion
    lip: str = "both"  # "upper" and "lower" pull only that side of the mouth


MUSCLES: dict[str, Muscle] = {
    "zygomaticus": Muscle(
        {"mouthSmile": 1.0}, {"cheilion": 1.0}, {"zygion": 0.35, "lateral_orbit": 0.65}, 0.235, 13.5, 15.0
    ),
    "risorius": Muscle(
        {"mouthSmile": 0.25, "mouthStretch": 1.0}, {"cheilion": 1.0}, {"gonion": 0.5, "mid_masseter": 0.5},
        0.14, 13.0, 16.0,
    ),
    "buccinator": Muscle(
        {"mouthDimple": 1.0, "mouthSmile": 0.1}, {"cheilion": 1.0}, {"supra_m2": 1.0, "zygion": 0.3, "cheilion": -0.3},
        0.16, 9.0, 11.0,
    ),
    "depressor_anguli": Muscle(
        {"mouthFrown": 1.0, "mouthStretch": 0.25}, {"cheilion": 1.0}, {"sub_m2": 0.5, "menton": 0.5}, 0.27, 11.0, 11.0
    ),
    "levator_labii": Muscle(
        {"mouthUpperUp": 1.0, "mouthSmile": 0.12}, {"labrale_superius": 0.65, "cheilion": 0.35}, {"suborbital": 1.0},
        0.12, 12.0, 14.0, "upper",
    ),
    "levator_nasi": Muscle(
        {"noseSneer": 1.0}, {"alare": 0.8, "cheilion": 0.2}, {"endocanthion": 0.8, "nasion": 0.2}, 0.17, 8.5, 12.0,
        "upper",
    ),
    "depressor_labii": Muscle(
        {"mouthLowerDown": 1.0, "mouthStretch": 0.35}, {"labrale_inferius": 0.65, "cheilion": 0.35},
        {"menton": 0.6, "sub_m2": 0.4}, 0.21, 12.0, 11.0, "lower",
    ),
    "mentalis": Muscle(
        {"mouthShrugLower": 1.0}, {"pogonion": 0.6, "supramentale": 0.4}, {"labrale_inferius": 1.0}, 0.26, 13.0, 10.0,
        "lower",
    ),
    "cheek_raiser": Muscle(
        {"cheekSquint": 1.0, "mouthSmile": 0.35}, {"inferior_malar": 0.6, "lateral_orbit": 0.4},
        {"exocanthion": 0.5, "suborbital": 0.5, "supraorbital": 0.0}, 0.30, 11.0, 12.0,
    ),
    "frontalis_medial": Muscle(
        {"browInnerUp": 1.0}, {"supraorbital": 0.5, "glabella": 0.5}, {"frontal_eminence": 1.1, "supraorbital": -0.1},
        0.23, 13.0, 10.0,
    ),
    "frontalis_lateral": Muscle(
        {"browOuterUp": 1.0}, {"supraorbital": 1.0, "exocanthion": 0.4, "endocanthion": -0.4},
        {"frontal_eminence": 1.1, "supraorbital": -0.1, "exocanthion": 0.4, "endocanthion": -0.4}, 0.23, 13.0, 8.5,
    ),
    "corrugator": Muscle(
        {"browDown": 1.0}, {"supraorbital": 0.8, "glabella": 0.2}, {"nasion": 0.8, "glabella": 0.2}, 0.21, 10.0, 12.0
    ),
    "procerus": Muscle({"browDown": 0.5, "noseSneer": 0.3}, {"glabella": 1.0}, {"rhinion": 1.0}, 0.12, 10.0, 9.0),
}  # fmt: skip


@dataclass(frozen=True)
class Pull:
    """One muscle of one side on one neutral."""

    name: str
    side: str
    origin: FloatArray  # (3,) mm
    length: float  # mm that full contraction moves the insertion
    reach: FloatArray  # (n,) share of each vertex in it

    def velocity(self, at: FloatArray, contraction: float) -> FloatArray:
        """(n, 3) mm that skin at (n, 3) mm is pulled at a contraction in [0, 1]."""
        way = self.origin - at
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 5.0)
        pulled: FloatArray = (contraction * self.length * self.reach)[:, None] * way
        return pulled


def pulls_of(vertices: FloatArray, frame: Frame, traits: Traits, side_of_mouth: FloatArray) -> list[Pull]:
    """All muscles of a neutral (n, 3) mm; side_of_mouth (n,) is 0 on the upper lip and 1 on the lower one."""
    lips = {"upper": 1 - smoothstep(side_of_mouth), "lower": smoothstep(side_of_mouth), "both": np.ones(len(vertices))}
    pulls = []
    for name, muscle in MUSCLES.items():
        gains = traits.gain(name)
        ends = traits.offsets(f"{name}/insertion", INSERTION_MM), traits.offsets(f"{name}/origin", ORIGIN_MM)
        for i, side in enumerate(("left", "right")):
            rest = frame.place(muscle.insertion, side), frame.place(muscle.origin, side)
            length = float(np.linalg.norm(rest[1] - rest[0]))
            insertion, origin = (place + frame.world(end[i]) for place, end in zip(rest, ends, strict=True))
            reach = _reach(vertices, insertion, origin, muscle) * lips[muscle.lip]
            pulls.append(Pull(name, side, origin, gains[i] * muscle.strain * length, reach))
    return pulls


def _reach(vertices: FloatArray, insertion: FloatArray, origin: FloatArray, muscle: Muscle) -> FloatArray:
    """(n,) 1 at the insertion; cos^2 along the line, Gaussian beside it and beyond its insertion."""
    way = origin - insertion
    length = float(np.linalg.norm(way))
    along = (vertices - insertion) @ (way / length)
    beside = np.sum((vertices - insertion) ** 2, axis=1) - along**2
    fade = np.where(
        along > 0,
        np.cos(0.5 * np.pi * np.clip(along / length, 0, 1)) ** 2,
        np.exp(-0.5 * (along / muscle.beyond) ** 2),
    )
    return np.asarray(fade * np.exp(-0.5 * beside / muscle.width**2))
