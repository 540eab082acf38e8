"""Delta transfer: the source's displacements, added to the target as they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from retarget.check import check_frames, check_no_edits
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetResult, SolveInfo


@dataclass(frozen=True)
class DeltaTransfer(Retargeter):
    """T_i = T + (S_i - S), in mm: no examples, no parameters, no adaptation to the size or shape of the target."""

    needs_examples: ClassVar[bool] = False
    exact_on_self: ClassVar[bool] = True

    def prepare(self, pair: Pair) -> _Prepared:
        return _Prepared(pair)


@dataclass(frozen=True)
class _Prepared:
    pair: Pair

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        return _Fitted(self.pair)


@dataclass(frozen=True)
class _Fitted:
    pair: Pair

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits("delta transfer", edits)
        source_frames = check_frames("source_frames", source_frames, len(self.pair.source_neutral))
        frames = source_frames - self.pair.source_neutral + self.pair.target_neutral
        return RetargetResult(frames, (SolveInfo(),) * len(frames))
