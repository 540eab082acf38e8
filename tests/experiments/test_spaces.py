"""Search spaces and the trials that cover them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from experiments.spaces import Range, Scale, Space
from retarget.check import InvalidInput

PRESENT = {"_target_": "somewhere", "weight": 10.0, "other": 3.0, "kind": "soft", "patches": 80}
WIDE = {"weight": {"log": [0.1, 1000.0]}, "other": {"linear": [0.0, 4.0]}, "kind": {"choices": ["soft", "hard"]}}


def space(config: Mapping[str, Any], **present: Any) -> Space:
    return Space.from_config("plbs", config, PRESENT | present)


PRESENT_ADT = {"w_target": 10.0, "w_soft": 1.0}


def test_an_even_grid_that_holds_the_present_value_keeps_it_and_puts_it_first() -> None:
    values = [trial.values["weight"] for trial in space({"weight": {"log": [0.1, 1000.0]}}).trials(5, seed=0)]
    assert values == [10.0, 0.1, 1.0, 100.0, 1000.0]
    values = [trial.values["other"] for trial in space({"other": {"linear": [0.0, 4.0]}}).trials(5, seed=0)]
    assert values == [3.0, 0.0, 1.0, 2.0, 4.0]


def test_a_present_value_between_the_steps_is_a_trial_besides_an_even_grid() -> None:
    values = [trial.values["weight"] for trial in space({"weight": {"log": [1.0, 100.0]}}, weight=20.0).trials(4, 0)]
    assert values == [20.0, 1.0, 10.0, 100.0]


def test_every_space_gets_exactly_the_trials_asked_for_and_none_twice() -> None:
    for config in (WIDE, {"weight": WIDE["weight"]}, {"weight": WIDE["weight"], "other": WIDE["other"]}):
        for count in (1, 2, 3, 13):
            trials = space(config).trials(count, seed=0)
            assert len(trials) == len({tuple(trial.values.values()) for trial in trials}) == count
            assert trials[0].values == {name: PRESENT[name] for name in config}


def test_points_lie_in_the_space_and_spread_over_each_setting() -> None:
    trials = space(WIDE).trials(17, seed=0)[1:]
    decades = np.floor(np.log10([trial.values["weight"] for trial in trials]))
    assert sorted(decades) == [-1] * 4 + [0] * 4 + [1] * 4 + [2] * 4  # 16 Sobol points: 4 in each quarter
    assert sum(trial.values["kind"] == "hard" for trial in trials) == 8
    assert all(0 <= trial.values["other"] <= 4 for trial in trials)


def test_more_trials_begin_with_the_fewer_and_a_seed_decides_them() -> None:
    few, more = space(WIDE).trials(6, seed=0), space(WIDE).trials(20, seed=0)
    assert more[:6] == few
    assert space(WIDE).trials(6, seed=1)[1:] != few[1:]


def test_settings_may_follow_another_in_all_trials_but_the_present() -> None:
    trials = space({"weight": {"log": [0.1, 1000.0], "also": ["other"]}}).trials(3, seed=0)
    assert trials[0].settings == {"weight": 10.0, "other": 3.0}
    assert all(trial.settings["other"] == trial.settings["weight"] for trial in trials[1:])
    assert all(list(trial.values) == ["weight"] for trial in trials)


def test_a_present_configuration_among_the_points_is_not_tried_twice() -> None:
    """As it is after a study was followed: the next one has as many different trials."""
    first = Space.from_config("adt", {n: {"log": [0.1, 1000.0]} for n in ("w_target", "w_soft")}, PRESENT_ADT)
    taken = first.trials(13, seed=0)[5].values
    again = Space.from_config("adt", {n: {"log": [0.1, 1000.0]} for n in taken}, PRESENT_ADT | dict(taken))
    trials = [trial.values for trial in again.trials(13, seed=0)]
    assert trials[0] == taken
    assert taken not in trials[1:]


def test_numbers_have_two_digits_and_stay_within_the_range() -> None:
    assert Range(1e-8, 1.0, Scale.LOG).at(4 / 12) == 4.6e-6
    assert Range(1.04, 9.96, Scale.LINEAR).at(0.0) == 1.04
    assert Range(1.04, 9.96, Scale.LINEAR).at(1.0) == 9.96


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({}, "study.spaces.plbs: expected settings"),
        ([1], "study.spaces.plbs: expected settings"),
        ({"wieght": {"log": [1, 10]}}, "'wieght' is unknown.*'weight'"),
        ({"_target_": {"choices": ["a", "b"]}}, "'_target_' is unknown"),
        ({"weight": [1, 10]}, "expected one of log, linear, choices"),
        ({"weight": {"log": [1, 100], "linear": [1, 100]}}, "expected one of log, linear, choices"),
        ({"weight": {"cubic": [1, 100]}}, "'cubic' is unknown"),
        ({"weight": {"log": [100, 1]}}, "low below high"),
        ({"weight": {"log": [1, 10, 100]}}, "low below high"),
        ({"weight": {"log": [1, float("inf")]}}, "finite"),
        ({"weight": {"log": ["a", "b"]}}, "finite numbers"),
        ({"weight": {"log": [0.0, 100]}}, "positive numbers on a logarithmic scale"),
        ({"weight": {"log": [20.0, 100]}}, r"holds the present value.*\[20, 100\] without 10\.0"),
        ({"patches": {"log": [10, 100]}}, "whole numbers are searched as choices"),
        ({"kind": {"choices": ["soft"]}}, "at least two different values"),
        ({"kind": {"choices": ["soft", "soft"]}}, "at least two different values"),
        ({"kind": {"choices": ["firm", "hard"]}}, "holds the present value"),
        ({"weight": {"log": [1, 100], "also": "other"}}, "also: expected a list"),
        ({"weight": {"log": [1, 100], "also": ["others"]}}, "'others' is unknown.*'other'"),
        ({"weight": {"log": [1, 100], "also": ["other"]}, "other": {"linear": [0, 4]}}, "once, got other more than"),
    ],
)
def test_what_is_no_space_is_refused(config: Any, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        space(config)


@pytest.mark.parametrize(
    ("config", "count"),
    [({"kind": {"choices": ["soft", "hard"]}}, 3), ({"weight": {"linear": [9.9, 10.5]}}, 30)],
)
def test_a_space_with_too_few_trials_is_refused_with_their_number(config: Any, count: int) -> None:
    with pytest.raises(InvalidInput, match=f"expected {count} different trials"):
        space(config).trials(count, seed=0)
