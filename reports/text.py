"""Numbers as printed text."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

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


def decimals(values: Iterable[float], least: int = 3, most: int = 4, significant: int = 2) -> int:
    """Decimals for all values of a column, so that the middle one shows so many significant digits."""
    sizes = sorted(abs(value) for value in values if math.isfinite(value) and abs(value) > ROUNDING)
    if not sizes:
        return least
    return max(least, min(significant - 1 - math.floor(math.log10(sizes[len(sizes) // 2])), most))


def entry(value: float, digits: int = 3) -> str:
    """A number of a column: fixed digits, and the bound ``<0.001`` where they would all be zero; else as `number`."""
    if ROUNDING <= abs(value) < 0.5 * 10**-digits:
        bound = f"{10.0**-digits:.{digits}f}"
        return f"<{bound}" if value > 0 else f">{MINUS}{bound}"
    return number(value, digits)


def rank_biserial(value: float) -> str:
    """Two digits; ``>-1`` and ``<1`` where they would say that every pair agrees and not every pair does."""
    if 0.995 <= abs(value) < 1:
        return "<1" if value > 0 else f">{MINUS}1"
    return number(value, 2)


def estimate(value: float, low: float, high: float, digits: int = 3) -> str:
    """``0.123 [0.100, 0.150]``; `no result` for NaN."""
    return f"{number(value, digits)} {bounds(low, high, digits)}" if math.isfinite(value) else "no result"


def bounds(low: float, high: float, digits: int = 3, printed: Callable[[float, int], str] = number) -> str:
    """``[0.100, 0.150]``; ``[<1e-6]`` for two equal bounds; a dash in brackets where there is no interval.

    printed: how one number is.
    """
    if not (math.isfinite(low) and math.isfinite(high)):
        return "[\N{EN DASH}]"
    first, last = printed(low, digits), printed(high, digits)
    return f"[{first}]" if first == last and first.startswith(("<", ">")) else f"[{first}, {last}]"


def _power(value: float) -> str:
    return f"1e{round(math.log10(value))}".replace("-", MINUS)


def p_value(p: float) -> str:
    """Three decimals, two significant digits below; `not testable` for NaN."""
    if not math.isfinite(p):
        return "not testable"
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}" if p < 0.01 else f"{p:.3f}"


def seconds(value: float, *others: float) -> str:
    """A duration with its unit; others in the same unit, joined by dashes, without it: ``556 ms`` or ``419 - 2070``."""
    if not all(math.isfinite(v) for v in (value, *others)):
        return "n/a"
    factor, unit = next((f, u) for f, u in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")) if value * f >= 1 or u == "µs")
    shown = [f"{v * factor:.3g}" if v * factor < 1000 else f"{v * factor:.0f}" for v in (value, *others)]
    return " \N{EN DASH} ".join(shown[1:]) if others else f"{shown[0]} {unit}"
