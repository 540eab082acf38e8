"""Anatomical deformation transfer, the geometry-driven half of AnaConDaR, by itself (Algorithm 1 of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from retarget.anatomical_transfer import AnatomicalTransfer, AnatomySettings, without_template
from retarget.check import check_frames, check_no_edits
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetProblem, RetargetResult


@dataclass(frozen=True, kw_only=True)
class AnatomicalDeformationTransfer(AnatomySettings, Retargeter):
    """T_i = adt(S_i, S, T). The settings are those of `AnatomySettings`."""

    needs_examples: ClassVar[bool] = False

    def unsupported(self, problem: RetargetProblem) -> str | None:
        return without_template(problem, self.template)

    def prepare(self, pair: Pair) -> _Prepared:
        return _Prepared(AnatomicalTransfer(pair, self))


@dataclass(frozen=True)
class _Prepared:
    adt: AnatomicalTransfer

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        return _Fitted(self.adt)


@dataclass(frozen=True)
class _Fitted:
    adt: AnatomicalTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        check_no_edits("anatomical deformation transfer", edits)
        frames = check_frames("source_frames", source_frames, len(self.adt.pair.source_neutral))
        skins, infos = np.empty(frames.shape), []
        for i, carried in enumerate(map(self.adt.started(), frames)):
            skins[i] = carried.skin  # the rest of a state, its tets, takes megabytes
            infos.append(carried.info)
        return RetargetResult(skins, tuple(infos))
