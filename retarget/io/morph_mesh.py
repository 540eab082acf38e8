"""A mesh with named shapes and curves of their weights: what modelling and real-time tools animate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retarget.check import InvalidInput
from retarget.types import FloatArray

Positions = NDArray[np.floating[Any]]  # mm, of single or double precision


@dataclass(frozen=True, eq=False)
class MorphMesh:
    """At ``times[k]`` the mesh is neutral + sum_j weights[k, j] (shapes[j] - neutral), linear in between.

    Raises InvalidInput for arrays that do not fit together and for a name given twice.
    """

    name: str
    neutral: FloatArray  # (n, 3) mm
    shapes: Positions  # (m, n, 3) mm, whole shapes and no displacements
    shape_names: tuple[str, ...]  # m
    times: FloatArray  # (t,) s, increasing
    weights: FloatArray  # (t, m)
    about: Mapping[str, Any] = field(default_factory=dict)  # plain data that travels with the mesh

    def __post_init__(self) -> None:
        m, t = len(self.shape_names), len(self.times)
        for name, array, expected in (
            ("shapes", self.shapes, (m, *np.shape(self.neutral))),
            ("times", self.times, (t,)),
            ("weights", self.weights, (t, m)),
        ):
            if np.shape(array) != expected:
                raise InvalidInput(f"{self.name}, {name}: expected the shape {expected}, got {np.shape(array)}.")
        if len(set(self.shape_names)) < m:
            twice = next(name for name in self.shape_names if self.shape_names.count(name) > 1)
            raise InvalidInput(f"{self.name}: two shapes are called '{twice}', expected different names.")
        if t and (self.times[0] < 0 or (np.diff(self.times) <= 0).any()):
            raise InvalidInput(f"{self.name}, times: expected increasing times from 0 s, got {self.times[:5]} ...")

    def at(self, k: int) -> FloatArray:
        """(n, 3) mm: the mesh at ``times[k]``."""
        worn = np.flatnonzero(self.weights[k])
        return self.neutral + np.tensordot(self.weights[k, worn], self.shapes[worn] - self.neutral, axes=1)


def flipbook(
    name: str,
    neutral: FloatArray,
    frames: Positions,
    frame_names: Sequence[str],
    times: ArrayLike,
    about: Mapping[str, Any] | None = None,
) -> MorphMesh:
    """Frames (t, n, 3) mm at times (t,) s, each a shape of its own that is worn alone when its time comes."""
    at = np.asarray(times, dtype=np.float64)
    return MorphMesh(name, neutral, frames, tuple(frame_names), at, np.eye(len(at), len(frames)), about or {})
