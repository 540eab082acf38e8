"""Numbers as printed text."""

from __future__ import annotations

import math

MINUS = "\N{MINUS SIGN}"


def number(value: float, digits: int = 3) -> str:
    """Fixed digits; three significant ones for small values; `n/a` for NaN."""
    if value is None or not math.isfinite(value):
        return "n/a"
    if value != 0 and abs(value) < 10 ** (1 - digits):
        return f"{value:.2g}".replace("-", MINUS)
    return f"{value:.{digits}f}".replace("-", MINUS)


def estimate(value: float, low: float, high: float, digits: int = 3) -> str:
    """``0.123 [0.100, 0.150]``; `no result` for NaN."""
    if not math.isfinite(value):
        return "no result"
    if not (math.isfinite(low) and math.isfinite(high)):
        return number(value, digits)
    return f"{number(value, digits)} [{number(low, digits)}, {number(high, digits)}]"


def p_value(p: float) -> str:
    """Two significant digits, `not testable` for NaN."""
    if p is None or not math.isfinite(p):
        return "not testable"
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}" if p < 0.1 else f"{p:.2f}"


def seconds(value: float) -> str:
    """A duration with its unit."""
    if not math.isfinite(value):
        return "n/a"
    return f"{value * 1000:.3g} ms" if value < 1 else f"{value:.3g} s"
