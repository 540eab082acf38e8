"""A problem for methods that need a volumetric head: a block with a mouth, eyes, muscle and bones that is fast."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
import pytest

from retarget.anatomy.head import Head, HeadTemplate
from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray, Regions, RetargetProblem
from tests.retarget.simulation.box_head import box_head, box_template

TARGET = np.diag([1.05, 0.95, 1.02])
template = cache(box_template)


def box_problem(examples: int = 5, frames: int = 9) -> RetargetProblem:
    """The first `examples` of `frames` expressions are the examples; all form the animation."""
    box = template()
    source, target = (_expressions(box.skin @ shape.T, frames, seed) for shape, seed in ((np.eye(3), 1), (TARGET, 2)))
    return RetargetProblem(
        faces=box.faces,
        source_neutral=box.skin.copy(),
        target_neutral=box.skin @ TARGET.T,
        source_animation=source,
        target_examples=target[:examples],
        source_examples=source[:examples],
        regions=box.regions,
    )


def _expressions(neutral: FloatArray, count: int, seed: int) -> FloatArray:
    """(count, n, 3) mm: two smooth bumps on the front each, with a personal part; the back is still."""
    shared, own = np.random.default_rng(3), np.random.default_rng(seed)
    depth = np.clip(neutral[:, 2:] / np.ptp(neutral[:, 2]), 0, 1)  # 0 at the back
    frames = np.repeat(neutral[None], count, axis=0)
    for frame in frames:
        for _ in range(2):
            centre = shared.uniform([-20, 10, 20], [20, 45, 20])
            motion = shared.normal(0, 1.0, 3) + own.normal(0, 0.3, 3)
            frame += depth * np.exp(-((neutral - centre) ** 2).sum(1) / (2 * 12.0**2))[:, None] * motion
    return frames


@contextmanager
def heads_are_boxes() -> Iterator[None]:
    """While it lasts the box is a topology with a template, and its linear images are characters that fit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("retarget.character.load_template", _load)
        patch.setattr("retarget.character.fit_head", _fit)
        yield


def _load(faces: IntArray, regions: Regions, size: str = "coarse") -> HeadTemplate:
    if not np.array_equal(faces, template().faces):
        raise InvalidInput("template: none is known for this topology.")
    return template()


def _fit(box: HeadTemplate, neutral: FloatArray) -> Head:
    shape, *_ = np.linalg.lstsq(box.skin, neutral, rcond=None)
    return box_head(box, shape.T)
