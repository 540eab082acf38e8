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
from itertools import tee
from typing import Any

import numpy as np

from retarget.anatomical_transfer import AnatomicalTransfer, AnatomySettings, Carrier, joined, without_template
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
class Retargeted:
    """What became of one expression, by the names of the paper; all (n, 3) mm."""

    expression: FloatArray  # S_i
    rebuilt: FloatArray  # S_i^P
    smoothed: FloatArray  # the same after anacon if `source_anacon`
    blended: FloatArray  # T_i^P
    missing: FloatArray  # T_i^M - T
    draft: FloatArray  # T_i^P + T_i^M - T
    result: FloatArray  # T_i
    near: HeadState | None  # of the target, where adt left it
    solves: Mapping[str, SolveInfo]

    @property
    def info(self) -> SolveInfo:
        return joined(self.solves)


@dataclass(frozen=True)
class _Fitted:
    prepared: _Prepared
    blendshapes: BlendshapeTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        frames = check_frames("source_frames", source_frames, len(self.prepared.pair.source_neutral))
        done = list(self._retargeted(self._blended(frames), self.prepared.directed(edits)))

        def stacked(part: Callable[[Retargeted], FloatArray]) -> FloatArray:
            return np.array([part(one) for one in done]).reshape(frames.shape)

        parts = {
            "source_reconstruction": stacked(lambda one: one.smoothed),
            "plbs": stacked(lambda one: one.blended),
            "missing_source": stacked(lambda one: one.expression - one.smoothed),
            "missing_target": stacked(lambda one: one.missing),
            "draft": stacked(lambda one: one.draft),
        }
        return RetargetResult(stacked(lambda one: one.result), tuple(one.info for one in done), parts)

    def stream(
        self, source_frames: Iterable[FloatArray], edits: Mapping[str, Any] | None = None
    ) -> Iterator[Retargeted]:
        """Expressions (n, 3) mm one at a time, as they are drawn. Raises InvalidInput as a call does."""
        blended = (one for frame in source_frames for one in self._blended(check_frames("frame", frame[None])))
        return self._retargeted(blended, self.prepared.directed(edits))

    def _blended(self, frames: FloatArray) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Steps 2 and 3: S_i, S_i^P and T_i^P of frames (t, n, 3) mm."""
        blended = self.blendshapes(frames)
        return zip(frames, blended.source, blended.target, strict=True)

    def _retargeted(
        self, blended: Iterable[tuple[FloatArray, FloatArray, FloatArray]], anacon: Direction
    ) -> Iterator[Retargeted]:
        """From S_i, S_i^P and T_i^P to T_i."""
        rules = self.prepared.rules
        drafts, to_form, near = tee(self._drafts(blended, anacon), 3)
        if not rules.anacon:
            yield from drafts
            return
        formed = anacon.form((one.draft for one in to_form), (one.near for one in near), rules.streaming)
        for draft, head in zip(drafts, formed, strict=True):
            yield self._anacon(draft, head, anacon)  # eqs (6), (19)

    def _drafts(
        self, blended: Iterable[tuple[FloatArray, FloatArray, FloatArray]], anacon: Direction
    ) -> Iterator[Retargeted]:
        """T_i^P plus the missing blendshape, eqs (4) and (5)."""
        method, neutral = self.prepared, self.prepared.pair.target_neutral
        steps, to_carry = tee(self._smoothed(blended))
        missing = (method.pair.source_neutral + one.expression - one.smoothed for one in to_carry)  # eq. (4): S_i^M
        match method.rules.missing:
            case Missing.ADT:
                held = method.rules.held != Held.NOTHING
                for one, adt in zip(steps, method.adt.states(missing, held), strict=True):  # eq. (5)
                    delta, solves = adt.skin - neutral, {**one.solves, "adt": adt.info}
                    draft = anacon.strengthened(one.blended + delta)
                    yield replace(one, missing=delta, draft=draft, result=draft, near=adt.taken, solves=solves)
            case Missing.DT if method.dt is not None:
                for one, target in zip(steps, missing, strict=True):
                    delta = method.dt.displacements(target[None])[0]
                    draft = anacon.strengthened(one.blended + delta)
                    yield replace(one, missing=delta, draft=draft, result=draft)
            case _:
                for one in steps:
                    draft = anacon.strengthened(one.blended)
                    yield replace(one, draft=draft, result=draft)

    def _smoothed(self, blended: Iterable[tuple[FloatArray, FloatArray, FloatArray]]) -> Iterator[Retargeted]:
        """Steps 2 and 3 as they are, or with anacon on S_i^P."""
        still = np.zeros_like(self.prepared.pair.source_neutral)
        for expression, rebuilt, target in blended:
            smoothed, solves = rebuilt, {}
            if self.prepared.rules.source_anacon:
                anacon = self.prepared.anacon_source
                done = anacon.take(next(anacon.form([rebuilt])))
                smoothed, solves["source anacon"] = done.skin, done.info
            yield Retargeted(expression, rebuilt, smoothed, target, still, target, target, None, solves)

    def _anacon(self, draft: Retargeted, formed: HeadState, anacon: Direction) -> Retargeted:
        """Step 4 for the target's head as invSim formed it of the draft."""
        method, rules, y = self.prepared, self.prepared.rules, draft.draft
        miss = method.evidence.miss(draft.expression, draft.rebuilt)
        detail = np.zeros_like(y)
        if rules.completed:
            detail = method.evidence.detail(anacon.unfollowed(y, formed), miss)
        wanted = None
        if rules.held != Held.NOTHING:
            wanted = anacon.characteristics(method.adt.characteristics(draft.expression))
        if wanted is not None and rules.held == Held.EVIDENCE:
            wanted = method.evidence.held(wanted, y, miss)
        done = anacon.take(formed, wanted, detail)
        return replace(draft, result=done.skin, solves={**draft.solves, "anacon": done.info})
