"""The volumetric head of section 3.3: H = (S, M, B), soft tissue, muscle tissue and skull, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from retarget.types import FloatArray, IntArray, Regions


@dataclass(frozen=True)
class HeadTemplate:
    """What all heads of one skin topology share, and the shape it was meshed in.

    The tets cover the tissue between skin and skull; the skull is their inner boundary. Skull vertices that are
    neither cranium nor jaw (the gap between them) are free. n counts skin vertices, m tet vertices, t tets.
    """

    skin: FloatArray  # (n, 3) mm, the surface that was meshed, neck open
    faces: IntArray  # (f, 3) triangles of the skin
    regions: Regions  # of the skin
    vertices: FloatArray  # (m, 3) mm
    tets: IntArray  # (t, 4), positively oriented
    muscle: NDArray[np.bool_]  # (t,) True in M, False in S
    embedding: sp.csr_array  # P (n, m), rows sum to one: skin = P vertices + residual
    skull_faces: IntArray  # (g, 3) into vertices, facing out of the bone
    cranium: IntArray  # (c,) sorted vertices that move with the cranium
    jaw: IntArray  # (j,) sorted vertices that move with the jaw
    depths: Mapping[str, float]  # mm by landmark

    @property
    def skull(self) -> IntArray:
        """Sorted vertices of the skull, the free ones included."""
        return np.unique(self.skull_faces)

    @cached_property
    def fixed(self) -> IntArray:
        """Sorted vertices that move with a bone."""
        return np.union1d(self.cranium, self.jaw)


@dataclass(frozen=True)
class Head:
    """A template fitted to one character, at rest."""

    template: HeadTemplate
    skin: FloatArray  # (n, 3) mm: the character's neutral
    vertices: FloatArray  # (m, 3) mm
    condyles: FloatArray  # (2, 3) mm, left and right: the axis the jaw turns about
    depth_errors: Mapping[str, float]  # mm by landmark, found less wanted

    @property
    def residual(self) -> FloatArray:
        """(n, 3) mm from the embedded to the true skin, at rest."""
        residual: FloatArray = self.skin - self.template.embedding @ self.vertices
        return residual
