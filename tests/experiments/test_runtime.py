"""The study of the simulation's speed: its animation, its table, its mistakes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from experiments.runtime import STAGES, Performance, RuntimeStudy, perform, set_up, stream, summarise
from retarget.check import InvalidInput
from retarget.types import Examples, Pair
from tests.experiments.toy import toy
from tests.retarget.simulation.box_head import box_head

SETTINGS = {
    "name": "runtime",
    "title": "",
    "description": "",
    "seed": 0,
    "template": "coarse",
    "animation_frames": 50,
    "frames_per_expression": 10,
    "blendshapes": 5,
    "surfaces": ["soft"],
}


def test_the_animation_moves_smoothly_from_the_neutral_through_drawn_expressions() -> None:
    study, data = RuntimeStudy.from_config(SETTINGS), toy(subdivisions=4)
    frames = perform(study, data).frames
    everything = data.frames("a", range(len(data.expressions)))
    distance = np.linalg.norm(everything - frames[9], axis=2).max(axis=1)
    assert distance.min() < 1e-9  # the tenth frame is an expression of the dataset
    whole = np.concatenate([data.neutral("a")[None], frames])
    steps = np.linalg.norm(np.diff(whole, axis=0), axis=2).max(axis=1)
    jump = np.linalg.norm(whole[10] - whole[0], axis=1).max()
    assert steps[:10].max() < 0.16 * jump  # an even pace would be 0.1, the easing peaks at 1.5 times that


def test_the_missing_part_is_what_the_blendshapes_leave() -> None:
    study, data = RuntimeStudy.from_config(SETTINGS), toy(subdivisions=4)
    shown = perform(study, data)
    explained = shown.frames - (shown.missing - shown.pair.source_neutral)  # eq. (4), S_i^P
    left = np.linalg.norm(shown.missing - shown.pair.source_neutral, axis=2).mean()
    assert 0 < left < np.linalg.norm(shown.frames - shown.pair.source_neutral, axis=2).mean()
    more = perform(replace(study, blendshapes=30), data)
    assert np.linalg.norm(more.missing - more.pair.source_neutral, axis=2).mean() < left
    assert np.isfinite(explained).all()


@pytest.mark.parametrize("surface", ["soft", "hard"])
def test_an_animation_streams_through_the_simulations(surface: str) -> None:
    head = box_head()
    bump = np.exp(-((head.skin - [18.0, 40.0, 20.0]) ** 2).sum(axis=1) / 200.0)[:, None] * [0.0, 0.0, 1.0]
    frames = head.skin + np.linspace(0.2, 1.0, 4)[:, None, None] * bump
    pair = Pair(head.template.faces, head.skin, head.skin, head.template.regions)
    still = np.broadcast_to(head.skin, frames.shape)
    advanced: list[int] = []
    engine = set_up(pair, head, head, surface, collisions=True)
    table = stream(engine, Performance(pair, Examples(still[:0], still[:0]), frames, frames, still), advanced.append)
    assert len(table) == len(advanced) == 4
    assert table["converged"].all()
    assert (table[list(STAGES)] > 0).all(axis=None)
    np.testing.assert_allclose(table[list(STAGES)].sum(axis=1), table["seconds"])


def test_rates_are_one_over_the_median_of_the_seconds() -> None:
    frames = pd.DataFrame(
        {
            "surface": "soft",
            "collisions": [False] * 3 + [True] * 3,
            "seconds": [0.1, 0.2, 9.0, 0.4, 0.5, 0.6],
            "setup_seconds": [1.0] * 3 + [2.0] * 3,
            "lip_depth_before": [0.0] * 5 + [2.5],
            "lip_depth_after": [0.0] * 5 + [0.04],
            "converged": [True] * 5 + [False],
        }
    )
    for stage in ("adt_inverse", "adt_forward", "anacon_inverse", "anacon_forward"):
        frames[stage] = frames["seconds"] / 4
    frames[["adt_iterations", "anacon_iterations"]] = 4
    [row] = summarise(frames).to_dict("records")
    assert (row["expressions_per_s"], row["expressions_per_s_collisions"]) == (5.0, 2.0)
    assert (row["setup_seconds"], row["expressions"], row["iterations"]) == (2.0, 3, 4.0)
    assert (row["expressions_with_contacts"], row["lip_depth_after_max"], row["not_converged"]) == (1, 0.04, 1)
    assert row["adt_inverse_ms"] == 125.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"animation_frames": 10}, "at least 50, got 10"),
        ({"template": "fine"}, "coarse"),
        ({"surfaces": ["firm"]}, "soft"),
    ],
)
def test_settings_out_of_range_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        RuntimeStudy.from_config(SETTINGS | change)


def test_too_few_expressions_are_refused_with_the_count() -> None:
    study = replace(RuntimeStudy.from_config(SETTINGS), blendshapes=38)
    with pytest.raises(InvalidInput, match="at least 43"):
        perform(study, toy(subdivisions=4))
