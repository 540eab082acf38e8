"""Which examples an artist wants used: gamma of Chandran et al. 2022, eq. (11).

    shape_preferences  {example: gamma} for all patches, or {patch number or region: {example: gamma}}

gamma is in [0, 1] and 1 where nothing is said; a smaller one makes the fit look for other examples that do the same,
and 0 leaves an example out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from retarget.artistic import patches_of
from retarget.check import InvalidInput
from retarget.rig.blendshapes import Patches
from retarget.suggest import choose
from retarget.types import FloatArray, Regions

WHERE = "shape_preferences"


def shape_preferences(given: Any, count: int, regions: Regions, patches: Patches) -> FloatArray:
    """(P, k) for k = count examples. Raises InvalidInput for unknown examples, patches or regions and for a gamma
    outside [0, 1]."""
    gamma = np.ones((len(patches), count))
    if not isinstance(given, Mapping):
        raise InvalidInput(f"{WHERE}: expected a mapping such as {{0: 0.5}}, got {given!r}.")
    for key, value in given.items():
        if isinstance(value, Mapping):
            chosen = _patches(key, regions, patches)
            for example, one in value.items():
                gamma[chosen, _example(example, count)] *= _gamma(example, one)
        else:
            gamma[:, _example(key, count)] *= _gamma(key, value)
    return gamma


def _patches(key: Any, regions: Regions, patches: Patches) -> list[int]:
    if isinstance(key, str):
        return patches_of(regions.vertices[choose(WHERE, key, regions.vertices)], patches)
    return [_whole(key, len(patches), "patches")]


def _example(key: Any, count: int) -> int:
    return _whole(key, count, "examples that build the models")


def _whole(key: Any, count: int, what: str) -> int:
    if isinstance(key, bool) or not isinstance(key, int | np.integer) or not 0 <= key < count:
        raise InvalidInput(f"{WHERE}: expected one of the {count} {what}, numbers from 0, got {key!r}.")
    return int(key)


def _gamma(key: Any, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 <= value <= 1:
        raise InvalidInput(f"{WHERE}[{key!r}]: expected a preference from 0 to 1, got {value!r}.")
    return float(value)
