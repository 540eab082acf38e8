"""ICT-FaceKit's 53 expressions by the names of ARKit's face units."""

from __future__ import annotations

import re

from synth_data.arkit import SKIN_NAMES

SPLIT = ("browInnerUp", "cheekPuff")  # one unit of ARKit, a left and a right half in ICT-FaceKit

_SIDE = re.compile(r"(?<=[a-z])(Left|Right)$")
_UNSPLIT = ("jawLeft", "jawRight", "mouthLeft", "mouthRight")  # directions, not sides


def parts(unit: str) -> tuple[str, ...]:
    """The expressions of ICT-FaceKit whose displacements add up to a unit of `SKIN_NAMES`."""
    if unit in SPLIT:
        return f"{unit}_L", f"{unit}_R"
    if unit in _UNSPLIT:
        return (unit,)
    return (_SIDE.sub(lambda side: f"_{side[0][0]}", unit),)


EXPRESSIONS: tuple[str, ...] = tuple(sorted(name for unit in SKIN_NAMES for name in parts(unit)))
