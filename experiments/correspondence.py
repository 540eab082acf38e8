"""`study.correspondence`: which source expressions a method is told to correspond to the target's examples."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from baselines.ebfr import ExampleBasedRetargeting
from experiments.catalogue import make_method, method_settings, options
from retarget.anacondar import AnaConDaR
from retarget.check import InvalidInput
from retarget.embedding import embed_examples
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import Patches, Ridge
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.rig.ebfr import EbfrSettings, ExampleBasedRigging
from retarget.suggest import choose
from retarget.types import Examples, Fitted, FloatArray, Pair, Retargeter, SolveInfo, Status

CORRESPONDENCES = ("given", "embedded", "ebfr", "paper")


@dataclass(frozen=True)
class Known:
    """What the study knows when it fills in the source examples of one cell."""

    names: tuple[str, ...]  # (k,) expressions of the examples
    source_examples: FloatArray  # (k, n, 3) mm: the same expressions, performed by the source
    target_examples: FloatArray  # (k, n, 3) mm
    animation: FloatArray  # (N, n, 3) mm: the source's animation
    span: str = ""  # tells animations of one pair apart
    method: Retargeter | None = None  # that asks; None: a reference


@dataclass(frozen=True)
class Found:
    """What the method is given."""

    examples: FloatArray | None  # (k, n, 3) mm, or None: the method needs none
    seconds: float = 0.0  # that a user of these examples alone would wait for them
    solves: tuple[SolveInfo, ...] = ()  # (k,)


class Correspondence(Protocol):
    """Source examples for the cells of one pair."""

    def __call__(self, known: Known) -> Found: ...


class Remembered:
    """A correspondence that does once what it does for a set of expressions, whatever method asks."""

    def __init__(self, find: Correspondence) -> None:
        self._find = find
        self._found: dict[tuple[str, tuple[str, ...]], Found] = {}

    def __call__(self, known: Known) -> Found:
        asked = known.span, known.names
        if asked not in self._found:
            self._found[asked] = self._find(known)
        return self._found[asked]


@dataclass(frozen=True)
class EmbeddingSettings:
    """`study.embedding`: how target examples are embedded in the source's domain (paper, section 3.5).

    transfer: the method of eq. (20); it needs no examples. patch_count, seed: METIS patches of the fit of eq. (21), or
    None for one fit of the whole mesh. lambda_reg: mm^2 per vertex.
    """

    transfer: Retargeter
    patch_count: int | None
    lambda_reg: float
    seed: int = 0
    facts: Mapping[str, Any] = field(default_factory=dict)  # plain data that decides the numbers

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> EmbeddingSettings:
        """Raises InvalidInput for an unknown method or a regulariser out of range."""
        name = choose("study.embedding.transfer", config["transfer"], options("method"))
        Ridge(config["lambda_reg"])
        facts = {**config, "transfer": dict(method_settings(name))}
        return EmbeddingSettings(make_method(name), config["patch_count"], config["lambda_reg"], config["seed"], facts)


@dataclass(frozen=True)
class RiggingSettings:
    """`study.rigging`: how example-based facial rigging makes source examples (paper, section 4.2.1).

    deformation_transfer: `area` | `uniform`; all else as in `EbfrSettings`.
    """

    rules: EbfrSettings
    deformation_transfer: Weighting
    facts: Mapping[str, Any] = field(default_factory=dict)  # plain data that decides the numbers

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> RiggingSettings:
        """Raises InvalidInput for a setting that is unknown or out of range."""
        rules = dict(config)
        weighting = choose("study.rigging.deformation_transfer", rules.pop("deformation_transfer"), Weighting)
        for name in rules:
            choose("study.rigging", name, EbfrSettings.__dataclass_fields__)
        return RiggingSettings(EbfrSettings(**rules), Weighting(weighting), dict(config))


def correspondences(
    pair: Pair, asked: Collection[str], embedding: EmbeddingSettings | None, rigging: RiggingSettings | None
) -> dict[str, Correspondence]:
    """Those of `CORRESPONDENCES` that are asked for; what two of them need is made once.

    Raises InvalidInput where settings are missing.
    """
    made: dict[str, Correspondence] = {"given": Given()}
    if {"embedded", "paper"} & set(asked):
        if embedding is None:
            raise InvalidInput("study.embedding: expected settings for the correspondence `embedded`, got none.")
        made["embedded"] = Remembered(Embedded(pair, embedding))
    if {"ebfr", "paper"} & set(asked):
        if rigging is None:
            raise InvalidInput("study.rigging: expected settings for the correspondence `ebfr`, got none.")
        made["ebfr"] = Remembered(Rigged(pair, rigging))
    if "paper" in asked:
        made["paper"] = AsPublished(made["embedded"], made["ebfr"])
    return {name: made[name] for name in asked}


class Given:
    """The source performs the same expressions as the examples (paper, section 3.2.1)."""

    def __call__(self, known: Known) -> Found:
        return Found(known.source_examples)


class Embedded:
    """The target's examples carried over to the source and rebuilt from its animation (paper, section 3.5).

    Each is carried once, by itself, so that a result does not depend on what was asked for before.
    """

    def __init__(self, pair: Pair, settings: EmbeddingSettings) -> None:
        self._pair, self._settings = pair, settings
        self._carried: dict[str, tuple[FloatArray, SolveInfo, float]] = {}

    def __call__(self, known: Known) -> Found:
        """Raises InvalidInput where the transfer cannot serve the pair, RuntimeError where it fails for an example."""
        carried = [self._carry(*one) for one in zip(known.names, known.target_examples, strict=True)]
        start = time.perf_counter()
        examples = embed_examples(
            known.target_examples,
            known.animation,
            self._pair.source_neutral,
            lambda _: np.array([frame for frame, _, _ in carried]),
            self._patches,
            Ridge(self._settings.lambda_reg),
        )
        seconds = time.perf_counter() - start + sum(carrying for _, _, carrying in carried)
        seconds += self._transfer[1] if carried else 0.0
        return Found(examples, seconds, tuple(solve for _, solve, _ in carried))

    @cached_property
    def _transfer(self) -> tuple[Fitted, float]:
        """From the target to the source, and the seconds of its set-up."""
        start = time.perf_counter()
        nothing = np.empty((0, *self._pair.source_neutral.shape))
        fitted = self._settings.transfer.prepare(_back(self._pair)).fit(Examples(nothing, nothing), nothing)
        return fitted, time.perf_counter() - start

    @cached_property
    def _patches(self) -> Patches | None:
        if self._settings.patch_count is None:
            return None
        count = len(self._pair.source_neutral)
        return contiguous_patches(self._pair.faces, count, self._settings.patch_count, self._settings.seed)

    def _carry(self, name: str, example: FloatArray) -> tuple[FloatArray, SolveInfo, float]:
        """Eq. (20) for (n, 3) mm."""
        if name not in self._carried:
            transfer, _ = self._transfer
            start = time.perf_counter()
            result = transfer(example[None])
            info = result.info[0]
            if info.status is Status.FAILED:
                raise RuntimeError(f"embedding of {name}: {info.message or 'its transfer failed without a reason'}.")
            self._carried[name] = result.frames[0], info, time.perf_counter() - start
        return self._carried[name]


class Rigged:
    """Blendshapes of the source, made from the target's examples by example-based facial rigging.

    The target's examples are the generic rig, and frames of the source's animation the examples: the source's
    counterparts are those expressions of it that make up its own performance, held to deformation transfer. This is
    how section 4.2.1 of the paper feeds LBS and ALM; it does not say what the generic rig is.
    """

    def __init__(self, pair: Pair, settings: RiggingSettings) -> None:
        self._pair, self._settings = pair, settings

    def __call__(self, known: Known) -> Found:
        """Raises InvalidInput where no example moves: nothing can be made of them."""
        if len(known.names) and not (known.target_examples != self._pair.target_neutral).any():
            raise InvalidInput("none of the target's examples differs from its neutral.")
        rigging, preparing = self._rigging
        start, rules = time.perf_counter(), self._settings.rules
        rig = rigging.rig(rigging.generic(known.target_examples, rules), known.animation, rules)
        info = SolveInfo(iterations=rules.alternations, energy=rig.misfit)
        return Found(rig.shapes, preparing + time.perf_counter() - start, (info,) * len(known.names))

    @cached_property
    def _rigging(self) -> tuple[ExampleBasedRigging, float]:
        """From the target to the source, and the seconds of its set-up."""
        start = time.perf_counter()
        transfer = DeformationTransfer.of(_back(self._pair), self._settings.deformation_transfer)
        return ExampleBasedRigging(transfer), time.perf_counter() - start


class AsPublished:
    """Section 4.2.1 of the paper: AnaConDaR embeds, all other methods are fed by example-based facial rigging.

    As a retargeting method that needs no source examples and is given none.
    """

    def __init__(self, embedded: Correspondence, rigged: Correspondence) -> None:
        self._embedded, self._rigged = embedded, rigged

    def __call__(self, known: Known) -> Found:
        if isinstance(known.method, ExampleBasedRetargeting):
            return Found(None)
        return (self._embedded if isinstance(known.method, AnaConDaR) else self._rigged)(known)


def _back(pair: Pair) -> Pair:
    return Pair(pair.faces, pair.target_neutral, pair.source_neutral, pair.regions)
