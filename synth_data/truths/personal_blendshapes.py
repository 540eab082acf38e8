"""Personal blendshapes: the generic rig's units, made one person's own, blended linearly.

The generic rig is one displacement field for everybody, so unchanged it would be delta transfer by construction. Here
unit j of a person displaces vertex i by

    gain_j * s_i R_i (I + M_j(x_i)) delta_ij

where (s_i, R_i) is the local similarity from the generic neutral to the person's, M_j a smooth random tensor field (a
part shared by all units of the person, and a part of each unit) and gain_j a random factor with left/right
asymmetry. The form keeps what a unit must keep: it moves nothing where the generic unit moves nothing, and
neighbours across the lips or the lids move alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from retarget.types import FloatArray, IntArray
from synth_data.arkit import MIRRORED, SKIN_NAMES
from synth_data.blink import close_lids
from synth_data.cache import ArrayCache
from synth_data.dataset import Progress
from synth_data.truth import FLIP, Blendshapes, Casting, GenericRig, Person, Truth

GAIN_DEVIATION = 0.1  # of the logarithm of a unit's gain
ASYMMETRY = 0.1  # deviation of the relative difference of a unit's gain to its mirror image's
FIELD_DEVIATION = 0.108  # of each entry of the tensor field
FIELD_LENGTH = 40.0  # mm over which the tensor field changes
SHARED = 0.4  # share of the field's variance that all units of a person have in common
LOPSIDED = 0.1  # share of the field's variance that is not mirror-symmetric
NEIGHBOURHOOD = 12.0  # mm, of the local similarity
TIED = {"mouthClose": "jawOpen"}  # closes the lips that the other one opens, so it must be personalised alike

_STREAM = 2  # of the seed


@dataclass(frozen=True)
class PersonalBlendshapes(Truth):
    """`personal_deltas`, blended linearly."""

    favours: ClassVar[str] = (
        "The ground truth is synthetic: personal ARKit blendshapes blended linearly. LBS becomes exact as the examples "
        "span the 51 units, so this truth favours linear methods with many examples. The personal units are pointwise "
        "transforms of one shared displacement field and move the same vertices for everybody, so it also favours "
        "delta transfer over deformation transfer, and thereby penalises the residual controls. It was made without "
        "any real expression and shows nothing about contact, skin sliding or other non-linear motion."
    )

    def prepare(self, generic: GenericRig, cache: ArrayCache, progress: Progress) -> Casting:
        return lambda person: Blendshapes(person.neutral, personal_deltas(person, generic))


def personal_deltas(person: Person, generic: GenericRig) -> FloatArray:
    """(51, n, 3) mm: displacements of `SKIN_NAMES` at full strength for one person; a full blink closes the eye.

    Raises InvalidInput for regions that do not name the margins of the lids.
    """
    deltas = generic.deltas.copy()
    similarity = local_similarity(generic.neutral, person.neutral)
    way = _Way(person.traits.seed, person.traits.flipped, generic)
    for delta, name in zip(deltas, SKIN_NAMES, strict=True):
        tensor = way.gain(name) * similarity @ (np.eye(3) + way.field(name))
        delta[:] = np.einsum("nij,nj->ni", tensor, delta)
    for side in ("left", "right"):
        blink = SKIN_NAMES.index(f"eyeBlink{side.title()}")
        deltas[blink] = close_lids(deltas[blink], person.neutral, generic.neutral, generic.regions, side)
    return deltas


def local_similarity(base: FloatArray, vertices: FloatArray) -> FloatArray:
    """(n, 3, 3) scale times rotation of the best similarity from base to vertices (n, 3) around each vertex."""
    near = cKDTree(base).sparse_distance_matrix(cKDTree(base), 2.5 * NEIGHBOURHOOD, output_type="coo_matrix")
    weights = sp.csr_array((np.exp(-0.5 * (near.data / NEIGHBOURHOOD) ** 2), near.coords), shape=near.shape)
    weights = sp.diags_array(1 / np.asarray(weights.sum(axis=1))) @ weights
    mean_base, mean = weights @ base, weights @ vertices
    products = (vertices[:, :, None] * base[:, None, :]).reshape(-1, 9)
    covariance = (weights @ products).reshape(-1, 3, 3) - mean[:, :, None] * mean_base[:, None, :]
    variance = weights @ (base**2).sum(axis=1) - (mean_base**2).sum(axis=1)
    u, sigma, vt = np.linalg.svd(covariance)
    sigma[:, 2] *= (sign := np.sign(np.linalg.det(u @ vt)))
    u[:, :, 2] *= sign[:, None]
    return (sigma.sum(axis=1) / variance)[:, None, None] * (u @ vt)


@dataclass(frozen=True)
class _Way:
    """The random traits of one seed, each drawn from a stream of its own, by name."""

    seed: int
    flipped: bool  # whether left and right are exchanged
    generic: GenericRig

    def gain(self, name: str) -> float:
        name = TIED.get(name, MIRRORED[name] if self.flipped else name)
        pair = min(name, MIRRORED[name])
        overall, difference = self._rng("gain", pair).normal(0, (GAIN_DEVIATION, ASYMMETRY))
        side = 0.0 if name == MIRRORED[name] else 0.5 if name == pair else -0.5
        return float(np.exp(overall) * (1 + side * difference))

    def field(self, name: str) -> FloatArray:
        """(n, 3, 3) the tensor field of a unit; that of its mirror image is its mirror image, up to `LOPSIDED`."""
        return self._mirrored(self._field(MIRRORED[name])) if self.flipped else self._field(name)

    def _field(self, name: str) -> FloatArray:
        name = TIED.get(name, name)
        pair = min(name, MIRRORED[name])
        own = self._smooth("unit", pair)
        if name == MIRRORED[name]:
            own = self._symmetrised(own)
        elif name != pair:
            own = self._mirrored(own)
        lopsided = self._smooth("lopsided", name)
        even = np.sqrt(SHARED) * self._of_all_units + np.sqrt(1 - SHARED) * own
        return FIELD_DEVIATION * (np.sqrt(1 - LOPSIDED) * even + np.sqrt(LOPSIDED) * lopsided)

    @cached_property
    def _of_all_units(self) -> FloatArray:
        return self._symmetrised(self._smooth("person"))

    def _smooth(self, *stream: str) -> FloatArray:
        """(n, 3, 3) random field of unit mean square over the head, by random Fourier features."""
        rng = self._rng(*stream)
        count = 48
        waves, phases = rng.standard_normal((3, count)) / FIELD_LENGTH, rng.uniform(0, 2 * np.pi, count)
        features = np.cos(self.generic.neutral @ waves + phases) * np.sqrt(2 / count)
        field = features @ rng.standard_normal((count, 9))
        return (field / np.sqrt(np.mean(field**2))).reshape(-1, 3, 3)

    def _symmetrised(self, field: FloatArray) -> FloatArray:
        return (field + self._mirrored(field)) / np.sqrt(2)

    def _mirrored(self, field: FloatArray) -> FloatArray:
        """As seen in a mirror at x = 0: each vertex has what its mirror image, or the nearest vertex to it, had."""
        return field[self._mirror] * np.outer(FLIP, FLIP)

    @cached_property
    def _mirror(self) -> IntArray:
        if self.generic.regions.mirror is not None:
            return self.generic.regions.mirror
        return np.asarray(cKDTree(self.generic.neutral).query(self.generic.neutral * FLIP)[1], dtype=np.int64)

    def _rng(self, *stream: str) -> np.random.Generator:
        words = (byte for word in stream for byte in [*word.encode(), 0])
        return np.random.default_rng(np.random.SeedSequence([self.seed, _STREAM, *words]))


TRUTH = PersonalBlendshapes()
