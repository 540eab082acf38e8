"""Seeded identities: adults from MakeHuman's macro and local targets, conditioned on published face widths.

The macro targets (gender, age, muscle, weight, ancestry) give a base; the local targets (nose, chin, ...) add a
Gaussian whose scale per target is set in mm of peak displacement. Unconditioned, these heads are off by several
millimetres (the mouth by 8), so the local coefficients are conditioned on face widths drawn from the published
distribution of the identity's gender, and every head keeps its true size. Lips that pass each other are parted last.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from retarget.check import InvalidInput
from retarget.geometry.procrustes import rigid_align
from retarget.types import FloatArray, IntArray, Regions
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.lips import RestingLips
from synth_data.makehuman.targets import LOCAL, Targets

ANCESTRIES = ("african", "asian", "caucasian")
LEVELS = ("min", "average", "max")
OPPOSITES = (
    ("incr", "decr"), ("up", "down"), ("in", "out"), ("forward", "backward"), ("convex", "concave"),
    ("compress", "uncompress"), ("pointed", "triangle"), ("square", "round"), ("l", "r"),
)  # fmt: skip
HEAD_SHAPES = ("diamond", "invertedtriangular", "oval", "rectangular", "round", "square", "triangular")
PEAK_MM = {
    "head": 2.4, "nose": 1.0, "mouth": 0.8, "eyes": 0.6, "chin": 1.5, "cheek": 1.2, "forehead": 1.8, "eyebrows": 1.4,
    "ears": 1.6, "asym": 0.45, "neck": 2.5,
}  # fmt: skip  # standard deviation of a target's peak displacement
LEVERS = {
    "mouth/mouth-scale-horiz-incr": 0.5, "nose/nose-scale-vert-incr": 0.4, "head/head-scale-horiz-incr": 0.25,
    "chin/chin-bones-incr": 0.4, "chin/chin-width-incr": 0.3,
}  # fmt: skip  # standard deviation of the coefficients that are made to change widths, so that conditioning acts there
EXCLUDED = (
    "head-trans", "head-angle", "measure-", "asymm-", "neck-scale-vert", "neck-trans", "nose-trans-in",
    "nose-trans-out", "mouth-trans-in", "mouth-trans-out", "nose-compression",
)  # fmt: skip  # rigid motion, the body's business, or sideways doubles of `asym`
GROWTH = {"man": 1.0, "woman": 1.03}  # MakeHuman's women are small for the published face widths
SIZE, SIZE_DEVIATION = 0.07, 0.4  # growth of the whole head at coefficient 1, and the coefficient's deviation
LARGEST = 1.0  # of a local coefficient: where MakeHuman's own sliders end
WIDTHS_CORRELATE = 0.4  # large heads are large in every width; the source gives no correlations
# Widths that the targets can reach together only by distorting the face give caricatures, so such draws are repeated.
LARGEST_STRAIN = 5.0  # standard deviations that conditioning may move a draw; one that needs more is drawn again
ATTEMPTS = 30  # draws of an identity before its seed is refused
SIDES_CORRELATE = 0.96  # between a target and its mirror image


@dataclass(frozen=True)
class Widths:
    """Mean and standard deviation over adults, in mm (doi:10.1186/s40902-019-0191-7)."""

    landmarks: tuple[str, str]
    men: tuple[float, float]
    women: tuple[float, float]


WIDTHS = {
    "zygion-zygion": Widths(("zygion_left", "zygion_right"), (133.8, 4.6), (130.1, 3.5)),
    "gonion-gonion": Widths(("gonion_left", "gonion_right"), (106.6, 5.9), (96.8, 2.9)),
    "cheilion-cheilion": Widths(("cheilion_left", "cheilion_right"), (55.9, 3.3), (52.0, 4.0)),
    "nasion-subnasale": Widths(("nasion", "subnasale"), (51.0, 1.9), (47.6, 3.1)),
}


@dataclass(frozen=True)
class Identity:
    """One synthetic adult; vertices (n, 3) mm, aligned to the base head on the cranium."""

    seed: int
    gender: str  # "man" for even seeds, "woman" for odd ones
    age: float  # years, as MakeHuman's targets understand them: 25 (young) to 90 (old)
    vertices: FloatArray


def measure(vertices: FloatArray, landmarks: Mapping[str, int]) -> FloatArray:
    """(4,) the distances of `WIDTHS` in mm."""
    a, b = (vertices[ends] for ends in _ends(landmarks).T)
    return np.linalg.norm(a - b, axis=1)


class IdentitySampler:
    """Draws identities on one base head; the same seed gives the same head, whatever was drawn before.

    Raises InvalidInput for a seed whose draws all need a distorted face (none is known).
    """

    def __init__(self, head: BaseHead, targets: Targets, regions: Regions):
        self._head = head
        self._targets = targets
        self._cranium = regions.vertices["cranium"]
        self._ends = _ends(regions.landmarks)
        self._positive, self._negative, self._covariance = _local_targets(head, targets)
        self._precision = np.linalg.inv(self._covariance)
        self._lips = RestingLips(head, regions)
        self._cholesky = np.linalg.cholesky(self._covariance)

    def __call__(self, seed: int) -> Identity:
        rng = np.random.default_rng(np.random.SeedSequence([seed, _STREAM]))
        gender = "man" if seed % 2 == 0 else "woman"
        mean, deviation = np.array([w.men if gender == "man" else w.women for w in WIDTHS.values()]).T
        for _ in range(ATTEMPTS):
            oldness = rng.beta(1.1, 2.8)
            base = GROWTH[gender] * (self._head.vertices + self._macro(rng, gender, oldness))
            drawn = np.sqrt(WIDTHS_CORRELATE) * rng.standard_normal() + np.sqrt(
                1 - WIDTHS_CORRELATE
            ) * rng.standard_normal(len(mean))
            free = self._cholesky @ rng.standard_normal(len(self._cholesky))
            vertices, strain = self._conditioned(base, free, mean + deviation * np.clip(drawn, -2, 2))
            if strain < LARGEST_STRAIN:
                break
        else:
            raise InvalidInput(
                f"Identity seed {seed}: none of {ATTEMPTS} draws reaches its face widths within {LARGEST_STRAIN} "
                "standard deviations, expected one; choose another dataset.first_seed."
            )
        rotation, translation = rigid_align(vertices[self._cranium], self._head.vertices[self._cranium])
        return Identity(seed, gender, 25 + 65 * oldness, self._lips(vertices @ rotation.T + translation))

    def _macro(self, rng: np.random.Generator, gender: str, oldness: float) -> FloatArray:
        """(n, 3) mm: MakeHuman's macro targets, weighted by the products of their factors' shares."""
        other = 0.25 * rng.beta(1, 3)  # share of the other gender
        man = 1 - other if gender == "man" else other
        ancestry = rng.dirichlet([0.5] * len(ANCESTRIES))
        muscle, weight = _levels(rng.normal(0.5, 0.15)), _levels(rng.normal(0.5, 0.17))
        total = np.zeros_like(self._head.vertices)
        for (sex, a), (age, b) in product(
            (("male", man), ("female", 1 - man)), (("young", 1 - oldness), ("old", oldness))
        ):
            for name, share in zip(ANCESTRIES, ancestry, strict=True):
                total += a * b * share * self._targets[f"macrodetails/{name}-{sex}-{age}"]
            for (i, m), (j, w) in product(enumerate(muscle), enumerate(weight)):
                if m * w > 0:
                    name = f"macrodetails/universal-{sex}-{age}-{LEVELS[i]}muscle-{LEVELS[j]}weight"
                    total += a * b * m * w * self._targets[name]
        return total

    def _conditioned(self, base: FloatArray, coefficients: FloatArray, wanted: FloatArray) -> tuple[FloatArray, float]:
        """(n, 3) mm: base and local targets with the Gaussian sample moved to where the widths are as wanted; and
        the Mahalanobis length of that move, infinite where the widths stay out of reach.

        c + C J^T (J C J^T)^-1 (wanted - widths(c)) is a sample of the Gaussian given linear widths (Matheron's
        rule); the widths are linear only piecewise, hence the iteration.
        """
        c = np.clip(coefficients, -LARGEST, LARGEST)
        for _ in range(8):
            shapes = np.where((c < 0)[:, None, None], -self._negative, self._positive)
            vertices = base + np.tensordot(c, shapes, axes=1)
            span = np.diff(vertices[self._ends], axis=1)[:, 0]
            length = np.linalg.norm(span, axis=1)
            if np.abs(wanted - length).max() < 0.2:
                move = c - coefficients
                return vertices, float(np.sqrt(move @ self._precision @ move))
            jacobian = np.einsum("wi,kwi->wk", span / length[:, None], np.diff(shapes[:, self._ends], axis=2)[:, :, 0])
            gain = self._covariance @ jacobian.T
            c = np.clip(c + gain @ np.linalg.solve(jacobian @ gain, wanted - length), -LARGEST, LARGEST)
        return vertices, np.inf


_STREAM = 1  # of the seed: identities; rigs use another


def _ends(landmarks: Mapping[str, int]) -> IntArray:
    """(4, 2) vertex indices of the ends of each width."""
    return np.array([[landmarks[name] for name in width.landmarks] for width in WIDTHS.values()])


def _levels(value: float) -> tuple[float, float, float]:
    """Shares of min, average and max for a slider in [0.15, 0.85]."""
    x = 2 * float(np.clip(value, 0.15, 0.85)) - 1
    return max(-x, 0.0), 1 - abs(x), max(x, 0.0)


def _local_targets(head: BaseHead, targets: Targets) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Shapes (k, n, 3) mm for positive and for negative coefficients, and the coefficients' covariance (k, k)."""
    opposite = dict(OPPOSITES)
    second = {f"{stem}-{b}" for a, b in OPPOSITES for stem in _stems(targets, a)}
    growth = SIZE * (head.vertices - head.vertices.mean(axis=0))
    names, positive, negative, deviations = ["size"], [growth], [-growth], [SIZE_DEVIATION]
    for name in targets:
        folder, _, file = name.partition("/")
        if folder not in LOCAL or file.startswith(EXCLUDED) or name in second:
            continue
        stem, _, ending = name.rpartition("-")
        partner = f"{stem}-{opposite[ending]}" if ending in opposite else None
        plus = targets[name]
        minus = targets[partner] if partner is not None and partner in targets else np.zeros_like(plus)
        if folder == "head" and ending in HEAD_SHAPES:
            plus, minus = plus * _lower_face(head), minus * _lower_face(head)
        peak = max(np.linalg.norm(shape, axis=1).max() for shape in (plus, minus))
        if peak > 0:
            names.append(name)
            positive.append(plus)
            negative.append(minus)
            deviations.append(LEVERS.get(name, min(PEAK_MM[folder] / peak, 0.5)))
    correlation = np.eye(len(names))
    for i, name in enumerate(names):
        if "/l-" in name:
            j = names.index(name.replace("/l-", "/r-"))
            correlation[i, j] = correlation[j, i] = SIDES_CORRELATE
    return np.array(positive), np.array(negative), correlation * np.outer(deviations, deviations)


def _stems(targets: Targets, ending: str) -> list[str]:
    return [name.removesuffix(f"-{ending}") for name in targets if name.endswith(f"-{ending}")]


def _lower_face(head: BaseHead) -> FloatArray:
    """(n, 1) 1 below the eyes, 0 above the brows: the targets of head shape would pull the vault into a cone."""
    t = np.clip((750.0 - head.vertices[:, 1:2]) / 35.0, 0, 1)
    return t * t * (3 - 2 * t)
