"""What an artist may change about a retargeted performance (AnaConDaR section 4.6), checked.

    control_points     {vertex or landmark: displacement (3,) mm}; the lip contour follows those on it by a space warp
    control_positions  {vertex or landmark: position (3,) mm}; the same, where the point shall be
    stiffness          {region: factor > 0} of the tissue in anacon
    gravity            (3,) m/s^2 that the result hangs under; performances are recorded under `materials.EARTH`
    patch_weights      {patch number or region: factor >= 0} of the expression's strength

An edit holds for all frames of a call. `Direction` applies them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from retarget.check import InvalidInput
from retarget.rig.blendshapes import Patches
from retarget.simulation.materials import EARTH, check_gravity
from retarget.suggest import choose, nearest
from retarget.types import FloatArray, IntArray, Regions

NAMES = ("control_points", "control_positions", "stiffness", "gravity", "patch_weights")


@dataclass(frozen=True)
class ControlPoints:
    """Skin vertices that a person moves."""

    vertices: IntArray  # (k,) ascending
    vectors: FloatArray  # (k, 3) mm
    placed: FloatArray  # (k,) 1 where the vector is a position, 0 where it is a displacement

    def displacements(self, skin: FloatArray) -> FloatArray:
        """(k, 3) mm on skin (n, 3) mm."""
        return self.vectors - self.placed[:, None] * skin[self.vertices]


@dataclass(frozen=True)
class Edits:
    """The edits of one call."""

    control: ControlPoints
    stiffness: tuple[tuple[str, float], ...]  # factor by region, without those that are 1
    gravity: FloatArray  # (3,) m/s^2
    strengths: FloatArray  # (p,) factor of each patch

    @staticmethod
    def of(edits: Mapping[str, Any] | None, regions: Regions, patches: Patches) -> Edits:
        """Raises InvalidInput for an unknown edit, region or landmark, numbers that do not fit or are out of range,
        and control points off the visible head."""
        given = {} if edits is None else _mapping("edits", edits)
        for name in given:
            choose("edits", name, NAMES)
        return Edits(
            _control(given, regions, sum(map(len, patches))),
            _stiffness(given.get("stiffness", {}), regions),
            check_gravity("gravity", _numbers("gravity", given.get("gravity", EARTH))),
            _strengths(given.get("patch_weights", {}), regions, patches),
        )


def patches_of(region: IntArray, patches: Patches) -> list[int]:
    """The patches with most of their vertices in the region (m,), and at least the one that holds most of it."""
    held = np.array([np.isin(patch, region).sum() for patch in patches])
    sizes = np.array([len(patch) for patch in patches])
    chosen = set(np.flatnonzero(2 * held > sizes).tolist()) | {int(np.argmax(held))}
    return sorted(chosen)


def _control(given: Mapping[str, Any], regions: Regions, count: int) -> ControlPoints:
    moved, placed = (
        {_vertex(name, key, regions, count): _vector(f"{name}[{key!r}]", value) for key, value in points.items()}
        for name, points in ((n, _mapping(n, given.get(n, {}))) for n in ("control_points", "control_positions"))
    )
    for vertex in moved.keys() & placed.keys():
        raise InvalidInput(f"control_positions: vertex {vertex} has a displacement in control_points; choose one.")
    every = moved | placed
    vertices = np.array(sorted(every), dtype=np.int64)
    return ControlPoints(
        vertices,
        np.array([every[v] for v in vertices]).reshape(-1, 3),
        np.array([float(v in placed) for v in vertices]),
    )


def _vertex(name: str, key: Any, regions: Regions, count: int) -> int:
    if isinstance(key, str):
        vertex = int(regions.landmarks[choose(f"{name}: landmark", key, regions.landmarks)])
    elif isinstance(key, int | np.integer) and not isinstance(key, bool):
        vertex = int(key)
    else:
        raise InvalidInput(f"{name}: expected vertex indices or names of landmarks, got {key!r}.")
    if not 0 <= vertex < count:
        raise InvalidInput(f"{name}: vertex {vertex} is none of the skin's, which are 0 to {count - 1}.")
    head = regions.vertices.get("head")
    if head is not None and not np.isin(vertex, head):
        raise InvalidInput(
            f"{name}: vertex {vertex} is not on the head that is seen (region 'head'); choose one that is."
        )
    return vertex


def _stiffness(given: Any, regions: Regions) -> tuple[tuple[str, float], ...]:
    factors = {
        choose("stiffness", name, regions.vertices): _factor(f"stiffness[{name!r}]", value, "> 0", lambda x: x > 0)
        for name, value in _mapping("stiffness", given).items()
    }
    return tuple(sorted((name, factor) for name, factor in factors.items() if factor != 1))


def _strengths(given: Any, regions: Regions, patches: Patches) -> FloatArray:
    """(p,); where several entries mean one patch their factors multiply, as those of stiffness do."""
    strengths = np.ones(len(patches))
    for name, value in _mapping("patch_weights", given).items():
        factor = _factor(f"patch_weights[{name!r}]", value, ">= 0", lambda x: x >= 0)
        if isinstance(name, str):
            chosen = patches_of(regions.vertices[choose("patch_weights", name, regions.vertices)], patches)
        elif isinstance(name, int | np.integer) and not isinstance(name, bool) and 0 <= name < len(patches):
            chosen = [int(name)]
        else:
            raise InvalidInput(
                f"patch_weights: expected names of regions or numbers of patches from 0 to {len(patches) - 1}, "
                f"got {name!r}."
            )
        strengths[chosen] *= factor
    return strengths


def _mapping(name: str, given: Any) -> Mapping[Any, Any]:
    if not isinstance(given, Mapping):
        hint = nearest(given, NAMES) if isinstance(given, str) else ""
        raise InvalidInput(f"{name}: expected a mapping, got {given!r}.{hint}")
    return given


def _factor(name: str, value: Any, range_: str, within: Callable[[float], bool]) -> float:
    factor = float(_numbers(name, value, ()))
    if not (np.isfinite(factor) and within(factor)):
        raise InvalidInput(f"{name}: expected a finite factor {range_}, got {value!r}.")
    return factor


def _vector(name: str, value: Any) -> FloatArray:
    vector = _numbers(name, value, (3,))
    if not np.isfinite(vector).all():
        raise InvalidInput(f"{name}: expected finite numbers in mm, got {value!r}.")
    return vector


def _numbers(name: str, value: Any, shape: Sequence[int] | None = None) -> FloatArray:
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{name}: expected numbers, got {value!r}.") from error
    if shape is not None and numbers.shape != tuple(shape):
        raise InvalidInput(f"{name}: expected {f'shape {tuple(shape)}' if shape else 'one number'}, got {value!r}.")
    return numbers
