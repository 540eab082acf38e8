"""Numbers as printed: rounding is called so, and a bound stands for what was divided by it."""

from __future__ import annotations

import math

import pytest

from reports.text import bounds, decimals, entry, estimate, number, rank_biserial


@pytest.mark.parametrize(
    ("value", "printed"),
    [
        (0.1234, "0.123"),
        (-0.1234, "\N{MINUS SIGN}0.123"),
        (2e-5, "2e\N{MINUS SIGN}05"),
        (0.0, "0.000"),
        (1e-15, "<1e\N{MINUS SIGN}6"),
        (-1e-15, ">\N{MINUS SIGN}1e\N{MINUS SIGN}6"),
        (9e12, ">1e6"),
        (math.nan, "n/a"),
    ],
)
def test_numbers(value: float, printed: str) -> None:
    assert number(value) == printed


def test_bounds_of_rounding_are_one_bound() -> None:
    assert bounds(1e-15, 2e-14) == "[<1e\N{MINUS SIGN}6]"
    assert bounds(1e-15, 0.5) == "[<1e\N{MINUS SIGN}6, 0.500]"
    assert bounds(0.5, 0.5) == "[0.500, 0.500]"
    assert estimate(1e-15, 1e-16, 1e-14) == "<1e\N{MINUS SIGN}6 [<1e\N{MINUS SIGN}6]"


def test_a_column_has_one_number_of_decimals_and_bounds_for_what_they_hide() -> None:
    column = [0.284, 5e-5, -9e-5, 1e-12, 0.0]
    assert [entry(value) for value in column] == [
        "0.284", "<0.001", ">\N{MINUS SIGN}0.001", "<1e\N{MINUS SIGN}6", "0.000",
    ]  # fmt: skip
    assert bounds(-1e-3, -9e-5, 3, entry) == "[\N{MINUS SIGN}0.001, >\N{MINUS SIGN}0.001]"
    assert decimals([0.5, 0.2, 3.0]) == 3
    assert decimals([0.002, -0.003, 7.0]) == 4
    assert decimals([1e-5, 1e-5]) == 4  # no more than that
    assert decimals([], least=1) == 1
    assert decimals([38.2, 45.0, math.nan], least=1, significant=3) == 1


def test_an_effect_is_one_only_where_every_pair_agrees() -> None:
    assert [rank_biserial(value) for value in (-1.0, -0.9957, -0.994, 0.999, 1.0)] == [
        "\N{MINUS SIGN}1.00", ">\N{MINUS SIGN}1", "\N{MINUS SIGN}0.99", "<1", "1.00",
    ]  # fmt: skip
