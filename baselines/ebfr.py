"""Example-based facial rigging as a retargeting method (AnaConDaR, section 4.2.2): the animation is the rig.

The frames of the source's animation are the generic blendshapes. Wanted is the target's animation, such that a linear
combination of it, without the examples, makes the target's examples, held to deformation transfer. See
`retarget.rig.ebfr`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from retarget.check import check_frames, check_no_edits
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.rig.ebfr import (
    Alternation,
    BoolArray,
    EbfrSettings,
    ExampleBasedRigging,
    Generic,
    blending_weights,
)
from retarget.rig.ebfr import Weighting as Explanation
from retarget.suggest import choose
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetProblem, RetargetResult, SolveInfo


@dataclass(frozen=True)
class ExampleBasedRetargeting(EbfrSettings, Retargeter):
    """T_i that explain the examples, held to dt(S_i, S, T); without examples it is deformation transfer.

    deformation_transfer: `area` (Botsch et al. 2006) or `uniform` (Sumner and Popovic 2004). The others are those of
    `EbfrSettings`. lambda_reg regularises alpha*: how the source's frames make the source's examples or, where these
    are unknown, how frames by deformation transfer make the target's. Raises InvalidInput for settings out of range.
    """

    # differs from Li et al.: frames are no units of a rig, and section 4.2.2 asks for "a linear combination"
    bounded: bool = False
    deformation_transfer: Weighting | str = Weighting.AREA

    def __post_init__(self) -> None:
        super().__post_init__()
        choose("deformation_transfer", self.deformation_transfer, Weighting)

    def unsupported(self, problem: RetargetProblem) -> str | None:
        examples = problem.target_examples
        if len(examples) and not (examples != problem.target_neutral).any():
            return "none of the target's examples differs from its neutral"
        return None

    def prepare(self, pair: Pair) -> _Prepared:
        rigging = ExampleBasedRigging(DeformationTransfer.of(pair, self.deformation_transfer))
        return _Prepared(self, pair, rigging)


@dataclass(frozen=True)
class _Prepared:
    settings: ExampleBasedRetargeting
    pair: Pair
    rigging: ExampleBasedRigging
    _latest: dict[str, Generic] = field(default_factory=dict)  # of one animation: the same for many sets of examples

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        rules, pair = self.settings, self.pair
        generic = self._generic(animation)
        used = np.ones(len(animation), dtype=bool)
        if examples.source is None:
            known, wanted = generic.transferred, examples.target - pair.target_neutral
        else:
            known, wanted = generic.moved, examples.source - pair.source_neutral
            used = _others(animation, examples.source)  # T without T_E
        prior, explain = blending_weights(known, wanted, rules.ridge(rules.lambda_reg), used=used)
        done = self.rigging.alternate(generic, examples.target, prior, rules, used)
        return _Fitted(self, done, explain, examples.source is not None)

    def _generic(self, animation: FloatArray) -> Generic:
        frames = check_frames("animation", animation, len(self.pair.source_neutral))
        digest = hashlib.blake2b(frames.tobytes()).hexdigest()
        if digest not in self._latest:
            self._latest.clear()
            self._latest[digest] = self.rigging.generic(frames, self.settings)
        return self._latest[digest]


@dataclass(frozen=True)
class _Fitted:
    prepared: _Prepared
    alternation: Alternation
    explain: Explanation  # alpha* of any frame
    given: bool  # the source's examples

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits("example-based facial rigging", edits)
        rigging, target = self.prepared.rigging, self.prepared.pair.target_neutral
        source_frames = check_frames("source_frames", source_frames, len(target))
        expressions = rigging.generic(source_frames, self.prepared.settings)
        prior = self.explain(expressions.moved if self.given else expressions.transferred)
        frames = target + self.alternation.follow(expressions, prior)
        info = SolveInfo(iterations=self.prepared.settings.alternations, energy=self.alternation.misfit)
        parts = {"deformation_transfer": target + expressions.transferred}
        return RetargetResult(frames, (info,) * len(frames), parts)


def _others(animation: FloatArray, examples: FloatArray) -> BoolArray:
    """(N,) which frames of the animation are none of the examples."""
    known = {example.tobytes() for example in examples}
    return np.array([frame.tobytes() not in known for frame in animation], dtype=bool)
