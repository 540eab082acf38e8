"""Numbers as printed text."""

from __future__ import annotations

import math

MINUS = "\N{MINUS SIGN}"


def number(value: float, digits: int = 3) -> str:
    """Fixed digits, or one significant one where they would all be zero; `n/a` for NaN."""
    if not math.isfinite(value):
        return "n/a"
    if value != 0 and abs(value) < 0.5 * 10**-digits:
        return f"{value:.1g}".replace("-", MINUS)
    return f"{value:.{digits}f}".replace("-", MINUS)


def estimate(value: float, low: float, high: float, digits: int = 3) -> str:
    """``0.123 [0.100, 0.150]``; `no result` for NaN."""
    if not math.isfinite(value):
        return "no result"
    if not (math.isfinite(low) and math.isfinite(high)):
        return number(value, digits)
    return f"{number(value, digits)} [{number(low, digits)}, {number(high, digits)}]"


def p_value(p: float) -> str:
    """Three decimals, two significant digits below; `not testable` for NaN."""
    if not math.isfinite(p):
        return "not testable"
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}" if p < 0.01 else f"{p:.3f}"


def seconds(value: float) -> str:
    """A duration with its unit."""
    if not math.isfinite(value):
        return "n/a"
    return f"{value * 1000:.3g} ms" if value < 1 else f"{value:.3g} s"
