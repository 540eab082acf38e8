"""A character as the simulation knows it: head and factors, made when first asked for and shared by all that ask."""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from retarget.anatomy.boundary import signed_volumes
from retarget.anatomy.fit import fit_head
from retarget.anatomy.head import Head, HeadTemplate
from retarget.anatomy.store import load_template
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSettings, InverseSimulation
from retarget.simulation.materials import region_stiffness
from retarget.types import FloatArray, IntArray, Pair, Regions

RegionFactors = tuple[tuple[str, float], ...]  # factors > 0 by region

KEPT_TEMPLATES = 4
KEPT_HEADS = 8
KEPT_SIMULATIONS = 6  # of each kind; their factors take some 100 MB each at the size `paper`


class TetWeights(StrEnum):
    """What the energy of a tet counts."""

    VOLUME = "volume"  # differs from the paper: tets count their volume, so that the mesh does not matter
    EQUAL = "equal"  # eqs (11), (12), (A.5), (A.6) as printed: each tet counts the same


@dataclass(frozen=True)
class Topology:
    """Faces and regions, compared by content."""

    digest: str
    faces: IntArray = field(compare=False, repr=False)  # (f, 3)
    regions: Regions = field(compare=False, repr=False)

    @staticmethod
    def of(faces: IntArray, regions: Regions) -> Topology:
        return Topology(_digest(faces, *_arrays(regions)), faces, regions)

    def template(self, size: str) -> HeadTemplate:
        """Raises InvalidInput where none is known; see `load_template`."""
        return _template(self, size)


@dataclass(frozen=True)
class Character:
    """A neutral skin (n, 3) mm in a topology, to be simulated with the template of one size; compared by content."""

    topology: Topology
    size: str  # of the template, coarse | paper
    tissue_depth: float  # of the soft-tissue depths at the landmarks, as a factor on the template's table
    digest: str
    neutral: FloatArray = field(compare=False, repr=False)

    @staticmethod
    def of(topology: Topology, size: str, neutral: FloatArray, tissue_depth: float = 1.0) -> Character:
        return Character(topology, size, tissue_depth, _digest(neutral), neutral)

    @property
    def head(self) -> Head:
        """fitHead of eq. (7). Raises InvalidInput as `fit_head` does."""
        return _head(self)

    def inverse(
        self, settings: InverseSettings, tets: TetWeights | str = TetWeights.VOLUME, stiffness: RegionFactors = ()
    ) -> InverseSimulation:
        """invSim of eq. (8), factorised. stiffness: see `region_stiffness`."""
        return _inverse(self, settings, TetWeights(tets), stiffness)

    def forward(
        self, settings: ForwardSettings, tets: TetWeights | str = TetWeights.VOLUME, stiffness: RegionFactors = ()
    ) -> ForwardSimulation:
        """fwdSim of eq. (10), factorised and condensed. stiffness: see `region_stiffness`."""
        return _forward(self, settings, TetWeights(tets), stiffness)


def characters(pair: Pair, size: str, tissue_depth: float = 1.0) -> tuple[Character, Character]:
    """Source and target of a pair, their heads fitted side by side. Raises InvalidInput as `fit_head` does."""
    topology = Topology.of(pair.faces, pair.regions)
    topology.template(size)  # once for both
    source, target = (Character.of(topology, size, v, tissue_depth) for v in (pair.source_neutral, pair.target_neutral))
    with threadpool_limits(limits=1), ThreadPoolExecutor(2) as pool:  # outside: `fit_head` limits and restores as well
        for _ in pool.map(_head, {source, target}):
            pass
    return source, target


def forget() -> None:
    """Drop all heads and factors that are kept, as a study of set-up times must."""
    for kept in (_template, _head, _inverse, _forward):
        kept.cache_clear()


@lru_cache(maxsize=KEPT_TEMPLATES)
def _template(topology: Topology, size: str) -> HeadTemplate:
    return load_template(topology.faces, topology.regions, size)


@lru_cache(maxsize=KEPT_HEADS)
def _head(character: Character) -> Head:
    template, factor = character.topology.template(character.size), character.tissue_depth
    if factor != 1.0:
        template = replace(template, depths={name: factor * depth for name, depth in template.depths.items()})
    return fit_head(template, character.neutral)


@lru_cache(maxsize=KEPT_SIMULATIONS)
def _inverse(
    character: Character, settings: InverseSettings, tets: TetWeights, stiffness: RegionFactors
) -> InverseSimulation:
    return InverseSimulation(character.head, settings, _stiffness(character.head, tets, stiffness))


@lru_cache(maxsize=KEPT_SIMULATIONS)
def _forward(
    character: Character, settings: ForwardSettings, tets: TetWeights, stiffness: RegionFactors
) -> ForwardSimulation:
    return ForwardSimulation(character.head, settings, _stiffness(character.head, tets, stiffness))


def _stiffness(head: Head, tets: TetWeights, stiffness: RegionFactors) -> FloatArray | float:
    """Factors (t,) on energies that count volume; those of the tets leave the sum of all weights as it is."""
    factors: FloatArray | float = region_stiffness(head, dict(stiffness)) if stiffness else 1.0
    if tets is TetWeights.VOLUME:
        return factors
    volumes = signed_volumes(head.vertices, head.template.tets)
    equal: FloatArray = factors * volumes.mean() / volumes
    return equal


def _arrays(regions: Regions) -> list[NDArray[Any]]:
    """All that simulations read of regions, in an order of its own, with the names."""
    found: list[NDArray[Any]] = []
    for part in (regions.vertices, regions.loops, regions.patches, regions.landmarks):
        for name in sorted(part):
            found += [_text(name), np.asarray(part[name], dtype=np.int64)]
    for name in sorted(regions.points):
        point = regions.points[name]
        found += [_text(name), point.indices, point.weights]
    return found


def _text(name: str) -> NDArray[Any]:
    return np.frombuffer(name.encode(), dtype=np.uint8)


def _digest(*arrays: NDArray[Any]) -> str:
    made = hashlib.sha256()
    for array in arrays:
        made.update(f"{array.dtype}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return made.hexdigest()
