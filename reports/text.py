"""Numbers as printed text."""

from __future__ import annotations

import math

MINUS = "\N{MINUS SIGN}"
ROUNDING = 1e-6  # a smaller value is zero but for rounding, whatever its unit, and is printed so


def number(value: float, digits: int = 3) -> str:
    """Fixed digits, or one significant one where they would all be zero; `n/a` for NaN.

    What is zero up to rounding, and what was divided by it, are bounds: `<1e-6`, `>1e6`.
    """
    if not math.isfinite(value):
        return "n/a"
    if 0 < value < ROUNDING:
        return f"<{_power(ROUNDING)}"
    if -ROUNDING < value < 0:
        return f">{MINUS}{_power(ROUNDING)}"
    if value > 1 / ROUNDING:
        return f">{_power(1 / ROUNDING)}"
    if value != 0 and abs(value) < 0.5 * 10**-digits:
        return f"{value:.1g}".replace("-", MINUS)
    return f"{value:.{digits}f}".replace("-", MINUS)


def estimate(value: float, low: float, high: float, digits: int = 3) -> str:
    """``0.123 [0.100, 0.150]``; `no result` for NaN."""
    return f"{number(value, digits)} {bounds(low, high, digits)}" if math.isfinite(value) else "no result"


def bounds(low: float, high: float, digits: int = 3) -> str:
    """``[0.100, 0.150]``; ``[<1e-6]`` for two equal bounds; a dash in brackets where there is no interval."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return "[\N{EN DASH}]"
    first, last = number(low, digits), number(high, digits)
    return f"[{first}]" if first == last and first.startswith(("<", ">")) else f"[{first}, {last}]"


def _power(value: float) -> str:
    return f"1e{round(math.log10(value))}".replace("-", MINUS)


def p_value(p: float) -> str:
    """Three decimals, two significant digits below; `not testable` for NaN."""
    if not math.isfinite(p):
        return "not testable"
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}" if p < 0.01 else f"{p:.3f}"


def seconds(*values: float) -> str:
    """A duration with its unit; several are joined by dashes and share the unit of the largest."""
    if not all(math.isfinite(v) for v in values):
        return "n/a"
    factor, unit = next((f, u) for f, u in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")) if max(values) * f >= 1 or u == "µs")
    return " \N{EN DASH} ".join(f"{v * factor:.3g}" if v < 1000 else f"{v:.0f}" for v in values) + f" {unit}"
