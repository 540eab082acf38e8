"""Numbers as printed: rounding is called so, and a bound stands for what was divided by it."""

from __future__ import annotations

import math

import pytest

from reports.text import bounds, estimate, number


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
