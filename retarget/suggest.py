"""Unknown names are refused with the nearest valid one."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

from retarget.check import InvalidInput


def nearest(name: str, valid: Iterable[str]) -> str:
    """'. Did you mean ...?' or nothing."""
    close = get_close_matches(name, list(valid), n=1, cutoff=0.5)
    return f" Did you mean '{close[0]}'?" if close else ""


def choose(what: str, name: str, valid: Iterable[str]) -> str:
    """`name` if it is valid; raises InvalidInput that lists what is."""
    valid = list(valid)
    if name not in valid:
        raise InvalidInput(f"{what}: '{name}' is unknown, expected one of {', '.join(valid)}.{nearest(name, valid)}")
    return name
