"""`study.correspondence`: which source expressions a method is told to correspond to the target's examples."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from experiments.catalogue import make_method, method_settings, options
from retarget.check import InvalidInput
from retarget.embedding import AnimationSpan
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import Patches, Ridge, whole_mesh
from retarget.suggest import choose
from retarget.types import Examples, Fitted, FloatArray, Pair, Retargeter, SolveInfo, Status


@dataclass(frozen=True)
class Known:
    """What the study knows when it fills in the source examples of one cell."""

    names: tuple[str, ...]  # (k,) expressions of the examples
    source_examples: FloatArray  # (k, n, 3) mm: the same expressions, performed by the source
    target_examples: FloatArray  # (k, n, 3) mm
    animation: FloatArray  # (N, n, 3) mm: the source's animation
    span: str = ""  # tells animations of one pair apart


@dataclass(frozen=True)
class Found:
    """What the method is given."""

    examples: FloatArray  # (k, n, 3) mm
    seconds: float = 0.0  # that a user of these examples alone would wait for them
    solves: tuple[SolveInfo, ...] = ()  # (k,)


class Correspondence(Protocol):
    """Source examples for the cells of one pair. What it does for an expression it does once."""

    def __call__(self, known: Known) -> Found: ...


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


class Given:
    """The source performs the same expressions as the examples (paper, section 3.2.1)."""

    def __call__(self, known: Known) -> Found:
        return Found(known.source_examples)


class Embedded:
    """The target's examples carried over to the source and rebuilt from its animation (paper, section 3.5).

    One expression at a time, so that a result does not depend on what was asked for before.
    """

    def __init__(self, pair: Pair, settings: EmbeddingSettings | None) -> None:
        if settings is None:
            raise InvalidInput("study.embedding: expected settings for the correspondence `embedded`, got none.")
        self._pair, self._settings = pair, settings
        self._carried: dict[str, tuple[FloatArray, SolveInfo, float]] = {}
        self._spans: dict[str, tuple[AnimationSpan, float]] = {}
        self._done: dict[tuple[str, str], tuple[FloatArray, float]] = {}

    def __call__(self, known: Known) -> Found:
        """Raises InvalidInput where the transfer cannot serve the pair, RuntimeError where it fails for an example."""
        examples, seconds, solves = np.empty_like(known.target_examples), 0.0, []
        for number, name in enumerate(known.names):
            _, solve, carrying = self._carry(name, known.target_examples[number])
            examples[number], fitting = self._embed(name, known)
            solves.append(solve)
            seconds += carrying + fitting
        if len(known.names):
            seconds += self._transfer[1] + self._spans[known.span][1]
        return Found(examples, seconds, tuple(solves))

    @cached_property
    def _transfer(self) -> tuple[Fitted, float]:
        """From the target to the source, and the seconds of its set-up."""
        start = time.perf_counter()
        pair = self._pair
        back = Pair(pair.faces, pair.target_neutral, pair.source_neutral, pair.regions)
        nothing = np.empty((0, *pair.source_neutral.shape))
        fitted = self._settings.transfer.prepare(back).fit(Examples(nothing, nothing), nothing)
        return fitted, time.perf_counter() - start

    @cached_property
    def _patches(self) -> Patches:
        count = len(self._pair.source_neutral)
        if self._settings.patch_count is None:
            return whole_mesh(count)
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

    def _embed(self, name: str, known: Known) -> tuple[FloatArray, float]:
        """Eq. (21)."""
        if known.span not in self._spans:
            start = time.perf_counter()
            ridge = Ridge(self._settings.lambda_reg)
            span = AnimationSpan(self._pair.source_neutral, known.animation, self._patches, ridge)
            self._spans[known.span] = span, time.perf_counter() - start
        if (known.span, name) not in self._done:
            start = time.perf_counter()
            embedded = self._spans[known.span][0](self._carried[name][0][None])[0]
            self._done[known.span, name] = embedded, time.perf_counter() - start
        return self._done[known.span, name]


CORRESPONDENCES: dict[str, Callable[[Pair, EmbeddingSettings | None], Correspondence]] = {
    "given": lambda pair, settings: Given(),
    "embedded": Embedded,
}
