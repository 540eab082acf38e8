"""AnaConDaR: anatomically-constrained data-adaptive facial retargeting (Wagner, Schwanecke and Botsch 2024).

The steps are those of the paper's Fig. 2.

    1  target examples without counterparts are embedded in the source's domain          section 3.5, eqs (20), (21)
    2  patchwise blendshapes of the examples rebuild the source's expression: S_i^P      section 3.2.1, eqs (1), (2)
    3  the same weights blend the target's examples: T_i^P                               eq. (3)
       and adt carries over what they miss, the missing blendshape: T_i^M                section 3.2.2, eqs (4), (5)
    4  anacon makes the sum anatomically plausible: T_i                                  section 3.4, eqs (6), (19)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from retarget.anatomical_transfer import (
    AnatomicalTransfer,
    AnatomySettings,
    Carried,
    Carrier,
    Former,
    former,
    joined,
    without_template,
)
from retarget.artistic import Edits
from retarget.check import check_frames, check_no_edits
from retarget.direction import Direction
from retarget.embedding import embed_examples
from retarget.evidence import Evidence, EvidenceSettings
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import BlendshapeTransfer, Patches, Residual, Ridge
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.simulation.state import HeadState
from retarget.suggest import choose
from retarget.types import Examples, FloatArray, Pair, Retargeter, RetargetProblem, RetargetResult, SolveInfo


class Missing(StrEnum):
    """What carries the missing blendshape over."""

    ADT = "adt"  # eq. (5)
    DT = "dt"  # ablation of section 4.5
    NOTHING = "nothing"  # ablation of section 4.5


class Held(StrEnum):
    """What anacon is held to besides the tissue."""

    CHARACTERISTICS = "characteristics"  # fc(S_i, S, T), eq. (19)
    EVIDENCE = "evidence"  # differs from the paper: as far as the examples leave an expression open, see `Evidence`
    NOTHING = "nothing"  # ablation of section 4.5, adt included


@dataclass(frozen=True, kw_only=True)
class AnaConDaR(AnatomySettings, Retargeter):
    """T_i = anacon(T_i^P + adt(S + S_i - S_i^P, S, T) - T, S_i, S, T); without examples anacon(adt(S_i)).

    Settings of the blendshapes: lambda_reg in squared units of `length_mm`, residual (see `Ridge`), and patch_count
    METIS patches, drawn with seed. The others are those of `AnatomySettings`.
    missing: see `Missing`. missing_collisions: resolve those of the lips in T_i^M as well. held: see `Held`.
    completed, sharpness, caution: see `Evidence`. source_anacon: anacon on S_i^P before eq. (4), section 4.5.
    anacon: False returns the draft T_i^P + T_i^M - T.
    Raises InvalidInput for settings out of range, and from `prepare` for heads that cannot be fitted.
    """

    lambda_reg: float
    residual: Residual | str = Residual.MEAN
    patch_count: int = 80
    seed: int = 0
    missing: Missing | str = Missing.ADT
    # differs from the paper: lips that cross in T_i^M, a difference put on the neutral, need not cross in the sum
    missing_collisions: bool = False
    held: Held | str = Held.EVIDENCE
    completed: bool = True  # differs from the paper: see `Evidence`
    sharpness: float = 1.0
    caution: float = 4.0
    source_anacon: bool = False
    anacon: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self.ridge, self.evidence  # noqa: B018  # raise for values out of range
        choose("missing", self.missing, Missing)
        choose("held", self.held, Held)

    @property
    def ridge(self) -> Ridge:
        return Ridge(self.lambda_reg, self.residual, self.length_mm)

    @property
    def evidence(self) -> EvidenceSettings:
        return EvidenceSettings(self.sharpness, self.caution)

    def unsupported(self, problem: RetargetProblem) -> str | None:
        return without_template(problem, self.template)

    def prepare(self, pair: Pair) -> _Prepared:
        patches = contiguous_patches(pair.faces, len(pair.source_neutral), self.patch_count, self.seed)
        adt = AnatomicalTransfer(pair, self, self.missing_collisions)
        dt = DeformationTransfer.of(pair, Weighting.UNIFORM) if self.missing == Missing.DT else None
        prepared = _Prepared(self, pair, patches, adt, dt, Evidence(pair, patches, self.evidence))
        prepared.directed(None)  # factors are made now, not with the first frame
        return prepared


@dataclass(frozen=True)
class _Prepared:
    rules: AnaConDaR
    pair: Pair
    patches: Patches
    adt: AnatomicalTransfer
    dt: DeformationTransfer | None
    evidence: Evidence

    def fit(self, examples: Examples, animation: FloatArray) -> _Fitted:
        pair, counterparts = self.pair, examples.source
        if counterparts is None:
            counterparts = self.embedded(examples.target, animation)  # step 1
        blendshapes = BlendshapeTransfer(
            pair.source_neutral, counterparts, pair.target_neutral, examples.target, self.patches, self.rules.ridge
        )
        return _Fitted(self, blendshapes)

    def embedded(self, target_examples: FloatArray, animation: FloatArray) -> FloatArray:
        """Step 1: the source's counterparts (k, n, 3) mm of target examples (k, n, 3) mm, section 3.5."""
        pair = self.pair
        back = Pair(pair.faces, pair.target_neutral, pair.source_neutral, pair.regions)
        alone = replace(self.rules, streaming=False)  # examples are no animation
        return embed_examples(target_examples, animation, pair.source_neutral, AnatomicalTransfer(back, alone))

    def directed(self, edits: Mapping[str, Any] | None) -> Direction:
        """anacon, fwdSim after invSim on the target's own head, eq. (19), under artistic edits, section 4.6."""
        if not self.rules.anacon:
            check_no_edits("AnaConDaR without anacon", edits)
        asked = Edits.of(edits, self.pair.regions, self.patches)
        target, rules = self.adt.target, self.rules
        anacon = Carrier(
            target.inverse(rules.inverse_settings, rules.tets, asked.stiffness),
            target.forward(rules.forward_settings, rules.tets, asked.stiffness),
        )
        unedited = target.inverse(rules.inverse_settings, rules.tets)
        return Direction(asked, self.pair, self.patches, anacon, unedited)

    @property
    def anacon_source(self) -> Carrier:
        """The same on the source's own head."""
        source, rules = self.adt.source, self.rules
        return Carrier(self.adt.carry.inverse, source.forward(rules.forward_settings, rules.tets))


@dataclass(frozen=True)
class Steps:
    """What became of one expression, by the names of the paper; all (n, 3) mm."""

    rebuilt: FloatArray  # S_i^P, after anacon if `source_anacon`
    blended: FloatArray  # T_i^P
    missing: FloatArray  # T_i^M - T
    draft: FloatArray  # T_i^P + T_i^M - T
    result: FloatArray  # T_i
    info: SolveInfo  # of all solves


@dataclass(frozen=True)
class _Fitted:
    prepared: _Prepared
    blendshapes: BlendshapeTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        frames = check_frames("source_frames", source_frames, len(self.prepared.pair.source_neutral))
        retarget, blended = _Performance.of(self.prepared, edits), self.blendshapes(frames)
        done = [retarget(*one) for one in zip(frames, blended.source, blended.target, strict=True)]

        def stacked(name: str) -> FloatArray:
            return np.array([getattr(steps, name) for steps in done]).reshape(frames.shape)

        parts = {
            "source_reconstruction": stacked("rebuilt"),
            "plbs": stacked("blended"),
            "missing_source": frames - stacked("rebuilt"),
            "missing_target": stacked("missing"),
            "draft": stacked("draft"),
        }
        return RetargetResult(stacked("result"), tuple(steps.info for steps in done), parts)

    def stream(self, source_frames: Iterable[FloatArray], edits: Mapping[str, Any] | None = None) -> Iterator[Steps]:
        """Expressions (n, 3) mm one at a time, as they are drawn. Raises InvalidInput as a call does."""
        retarget = _Performance.of(self.prepared, edits)
        for frame in source_frames:
            blended = self.blendshapes(frame[None])
            yield retarget(frame, blended.source[0], blended.target[0])


@dataclass(frozen=True)
class _Performance:
    """The method at work on frames in their order."""

    method: _Prepared
    adt: Callable[[FloatArray], Carried]
    form: Former  # invSim on the target's head
    anacon: Direction

    @staticmethod
    def of(method: _Prepared, edits: Mapping[str, Any] | None) -> _Performance:
        rules, anacon = method.rules, method.directed(edits)
        adt = method.adt.started(characteristics=rules.held != Held.NOTHING)
        return _Performance(method, adt, former(anacon.anacon.inverse, rules.streaming), anacon)

    def __call__(self, expression: FloatArray, rebuilt: FloatArray, blended: FloatArray) -> Steps:
        """Steps 3 and 4 for S_i, S_i^P and T_i^P (n, 3) mm."""
        rules, pair, solves = self.method.rules, self.method.pair, {}
        smoothed = rebuilt
        if rules.source_anacon:
            anacon_source = self.method.anacon_source
            done = anacon_source.take(anacon_source.inverse(rebuilt))
            smoothed, solves["source anacon"] = done.skin, done.info

        missing = pair.source_neutral + expression - smoothed  # eq. (4): S_i^M
        delta, near = np.zeros_like(blended), None
        match rules.missing:
            case Missing.ADT:
                carried = self.adt(missing)  # eq. (5): T_i^M
                delta, near, solves["adt"] = carried.skin - pair.target_neutral, carried.taken, carried.info
            case Missing.DT if self.method.dt is not None:
                delta = self.method.dt.displacements(missing[None])[0]
        draft = result = self.anacon.strengthened(blended + delta)

        if rules.anacon:
            formed = self.form(draft, near)
            miss = self.method.evidence.miss(expression, rebuilt)
            done = self._taken(expression, draft, formed, miss)  # eqs (6), (19): T_i
            result, solves["anacon"] = done.skin, done.info
        return Steps(smoothed, blended, delta, draft, result, joined(solves))

    def _taken(self, expression: FloatArray, draft: FloatArray, formed: HeadState, miss: FloatArray) -> Carried:
        """fwdSim of the target's head that formed the draft, held to what eq. (19) or `Evidence` says."""
        rules, evidence, detail, wanted = self.method.rules, self.method.evidence, np.zeros_like(draft), None
        if rules.completed:
            detail = evidence.detail(self.anacon.unfollowed(draft, formed), miss)
        if rules.held != Held.NOTHING:
            wanted = self.anacon.characteristics(self.method.adt.characteristics(expression))
        if wanted is not None and rules.held == Held.EVIDENCE:
            wanted = evidence.held(wanted, draft, miss)
        return self.anacon.take(formed, wanted, detail)
