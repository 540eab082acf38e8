"""What makes two people with equal faces move differently: gains, asymmetry, muscle ends, jaw, folds, seeded."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from retarget.check import InvalidInput
from retarget.types import FloatArray

_STREAM = 5  # of the seed
_FLIP = np.array([-1.0, 1.0, 1.0])

GAIN_DEVIATION = 0.18  # of the logarithm of a muscle's gain, both sides together
ASYMMETRY = 0.10  # deviation of the logarithm of the ratio between the sides' gains
ORIGIN_MM, INSERTION_MM = 4.0, 1.5  # deviation of a muscle's ends along each axis
LOPSIDED = 0.3  # share of that variance that differs between the sides
REFERENCE_MANDIBLE = 88.0  # mm from the condyles' axis to the incisors
OPENING, OPENING_DEVIATION = 42.0, 4.5  # mm between the incisors at full opening
GLIDE, GLIDE_DEVIATION = 6.0, 1.5  # mm, of the condyles at full opening
PROTRUSION, PROTRUSION_DEVIATION = 7.0, 1.5  # mm
LATERAL, LATERAL_DEVIATION = (11.8, 9.4), 2.5  # mm to the person's left and right
CURVATURE = (0.2, 1.6)  # least and most, evenly drawn; so are the next two
STIFFENING = (14.0, 20.0)  # mm
FOLD_WIDTH = (2.4, 3.5)  # mm
THICKNESS = 7.0  # mm, with a deviation of 1


@dataclass(frozen=True)
class Jaw:
    """Full excursions in mm of a mandible of `REFERENCE_MANDIBLE`; the face scales them with its own."""

    opening: float
    glide: float
    protrusion: float
    left: float
    right: float


@dataclass(frozen=True)
class Traits:
    """One person's way of moving. Sided traits hold (left, right); every muscle draws from a stream of its own name."""

    seed: int
    jaw: Jaw
    curvature: float  # k of the response (1 - exp(-k w)) / (1 - exp(-k))
    stiffening: float  # mm, where skin resists further motion
    thickness: float  # mm of soft tissue whose volume is kept
    fold_width: float  # mm
    age: float  # years; folds deepen with it
    flipped: bool = False  # whether left and right are exchanged

    def gain(self, name: str) -> tuple[float, float]:
        """Factors about 1 on a muscle's strength, (left, right)."""
        both, sides = _normals(self.seed, ("gain", name), (2,))
        level, half = np.exp(GAIN_DEVIATION * both), np.exp(0.5 * ASYMMETRY * sides)
        return self._sided(float(level * half), float(level / half))

    def offsets(self, name: str, deviation: float) -> tuple[FloatArray, FloatArray]:
        """Offsets (3,) mm of one end of a muscle, (left, right), mirror images up to `LOPSIDED`."""
        shared, left, right = deviation * _normals(self.seed, ("offset", name), (3, 3))
        even, odd = np.sqrt(1 - LOPSIDED), np.sqrt(LOPSIDED)
        drawn = even * shared + odd * left, _FLIP * (even * shared + odd * right)
        return (_FLIP * drawn[1], _FLIP * drawn[0]) if self.flipped else drawn

    def response(self, weight: FloatArray) -> FloatArray:
        """How far a muscle contracts at weights of any shape: 0 at 0, 1 at 1, concave."""
        answer: FloatArray = np.expm1(-self.curvature * weight) / np.expm1(-self.curvature)
        return answer

    def mirrored(self) -> Traits:
        """The same person seen in a mirror."""
        jaw = Jaw(self.jaw.opening, self.jaw.glide, self.jaw.protrusion, self.jaw.right, self.jaw.left)
        return Traits(
            self.seed, jaw, self.curvature, self.stiffening, self.thickness, self.fold_width, self.age, not self.flipped
        )

    def _sided(self, left: float, right: float) -> tuple[float, float]:
        return (right, left) if self.flipped else (left, right)


@functools.lru_cache(maxsize=4096)  # a face asks for its gains in every frame
def _normals(seed: int, stream: tuple[str, ...], shape: tuple[int, ...]) -> FloatArray:
    """Standard normal numbers of a seed's stream."""
    words = (byte for word in stream for byte in [*word.encode(), 0])
    drawn = np.random.default_rng(np.random.SeedSequence([seed, _STREAM, *words])).standard_normal(shape)
    drawn.flags.writeable = False
    return drawn


class _Average(Traits):
    """Nobody's way of moving: every gain is 1, every muscle ends where it is drawn."""

    def gain(self, name: str) -> tuple[float, float]:
        return 1.0, 1.0

    def offsets(self, name: str, deviation: float) -> tuple[FloatArray, FloatArray]:
        return np.zeros(3), np.zeros(3)

    def mirrored(self) -> Traits:
        return self


def average_traits(age: float = 40.0) -> Traits:
    """The means of all traits, with both sides alike; age in years."""
    lateral = float(np.mean(LATERAL))
    return _Average(
        seed=0,
        jaw=Jaw(OPENING, GLIDE, PROTRUSION, lateral, lateral),
        curvature=float(np.mean(CURVATURE)),
        stiffening=float(np.mean(STIFFENING)),
        thickness=THICKNESS,
        fold_width=float(np.mean(FOLD_WIDTH)),
        age=age,
    )


def draw_traits(seed: int, age: float) -> Traits:
    """The traits of a seed; age in years. Raises InvalidInput for a negative seed or an age that is no number."""
    if seed < 0:
        raise InvalidInput(f"seed: expected a whole number of at least 0, got {seed}.")
    if not np.isfinite(age):
        raise InvalidInput(f"age: expected years, got {age}.")
    rng = np.random.default_rng(np.random.SeedSequence([seed, _STREAM]))
    z = np.clip(rng.standard_normal(6), -2, 2)
    return Traits(
        seed=seed,
        jaw=Jaw(
            opening=OPENING + OPENING_DEVIATION * float(z[0]),
            glide=GLIDE + GLIDE_DEVIATION * float(z[1]),
            protrusion=PROTRUSION + PROTRUSION_DEVIATION * float(z[2]),
            left=LATERAL[0] + LATERAL_DEVIATION * float(z[3]),
            right=LATERAL[1] + LATERAL_DEVIATION * float(z[4]),
        ),
        curvature=float(rng.uniform(*CURVATURE)),
        stiffening=float(rng.uniform(*STIFFENING)),
        thickness=THICKNESS + float(z[5]),
        fold_width=float(rng.uniform(*FOLD_WIDTH)),
        age=float(age),
    )
