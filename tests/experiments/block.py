"""A dataset that methods with a volumetric head can serve at once: blocks with a mouth, whose lips can cross."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from retarget.types import FloatArray, Regions
from tests.conformance.box import TARGET, template
from tests.experiments.toy import Toy

MOUTH = 28.0  # mm, the height of the slit


def block(expressions: int = 12) -> Toy:
    """Identities a and b; every other expression closes the lips past each other. Needs `heads_are_boxes`."""
    box = template()
    lower_up = np.exp(-(box.skin[:, 0] ** 2) / (2 * 10.0**2)) * np.exp(-((box.skin[:, 1] - MOUTH) ** 2) / (2 * 6.0**2))
    lower_up = np.where(box.skin[:, 1] < MOUTH, lower_up * box.skin[:, 2] / 20.0, 0.0)[:, None] * [0.0, 2.5, 0.0]
    centres = np.array([[-15.0, 40, 20], [15, 40, 20], [0, 15, 20]])
    bumps = np.exp(-((box.skin[None] - centres[:, None]) ** 2).sum(-1) / (2 * 9.0**2))[:, :, None]
    units = np.concatenate([lower_up[None], bumps * (box.skin[:, 2:] / 20.0) * [0.5, 0.3, 1.0]])
    weights = np.random.default_rng(5).uniform(0, 1, (expressions, len(units)))
    weights[:, 0] = np.where(np.arange(expressions) % 2, 1.0, 0.0)
    rigs = {"a": units, "b": 0.9 * units}
    neutrals = {"a": box.skin.copy(), "b": box.skin @ TARGET.T}
    return Toy(box.faces, _with_landmarks(box.skin, box.regions), neutrals, rigs, weights)


def _with_landmarks(skin: FloatArray, regions: Regions) -> Regions:
    def nearest(x: float, y: float) -> int:
        return int(np.argmin(np.linalg.norm(skin - [x, y, 20.0], axis=1)))

    marks = {"cheilion_left": (20, MOUTH), "cheilion_right": (-20, MOUTH), "stomion_upper": (0, MOUTH + 0.5)}
    marks |= {"labrale_superius": (0, MOUTH + 4)}
    return replace(regions, landmarks={**regions.landmarks, **{name: nearest(*at) for name, at in marks.items()}})
