"""A dataset that is known in closed form: a bumpy sphere whose identities perform smooth random expressions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import trimesh

from retarget.types import FloatArray, IntArray, Regions
from synth_data.dataset import Conditions, Dataset


@dataclass(frozen=True)
class Toy(Dataset):
    faces: IntArray
    regions: Regions
    neutrals: dict[str, FloatArray]
    units: dict[str, FloatArray]  # identity -> (u, n, 3) mm
    weights: FloatArray  # (N, u)
    conditions: Conditions = field(default_factory=lambda: Conditions("toy", "linear", "dense"))
    favours: str = "It favours nobody."
    fingerprint: str = "toy"

    @property
    def identities(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(self.neutrals)

    @property
    def expressions(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(f"expression_{i:03d}" for i in range(len(self.weights)))

    def neutral(self, identity: str) -> FloatArray:
        return self.neutrals[identity]

    def frames(self, identity: str, indices: Sequence[int]) -> FloatArray:
        return self.neutrals[identity] + np.tensordot(self.weights[list(indices)], self.units[identity], axes=1)

    def with_neutral(self, identity: str, neutral: FloatArray) -> Toy:
        return replace(self, neutrals={**self.neutrals, identity: neutral})


def toy(identities: int = 3, expressions: int = 40, units: int = 8, subdivisions: int = 3) -> Toy:
    """Identities named a, b, c, ...; 642 vertices at 3 subdivisions; motion of about 5 mm."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=80.0)
    points = np.asarray(sphere.vertices)
    rng = np.random.default_rng(7)
    n = len(points)
    centres = points[rng.choice(n, units)]
    bumps = np.exp(-((points[None] - centres[:, None]) ** 2).sum(-1) / (2 * 40.0**2))  # (u, n)
    directions = rng.normal(size=(units, 3)) * 8
    neutrals, rigs = {}, {}
    for name in "abcdefgh"[:identities]:
        neutrals[name] = points * rng.normal(1, 0.08, 3) + 2 * rng.normal(size=(units, 3)).T.dot(bumps).T
        personal = directions + rng.normal(size=directions.shape) * 2
        rigs[name] = bumps[:, :, None] * personal[:, None]
    halves = {name: np.flatnonzero(points[:, axis] > 0) for axis, name in enumerate(("eyes", "lips", "face"))}
    regions = Regions(vertices={"head": np.arange(n), **halves, "cranium": np.flatnonzero(points[:, 1] < -40)})
    weights = rng.uniform(0, 1, (expressions, units)) * (rng.uniform(size=(expressions, units)) < 0.4)
    return Toy(np.asarray(sphere.faces, dtype=np.int64), regions, neutrals, rigs, weights)
