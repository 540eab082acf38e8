"""AnaConDaR: anatomically-constrained data-adaptive facial retargeting (Wagner, Schwanecke and Botsch 2024).

The steps are those of the paper's Fig. 2.

    1  target examples without counterparts are embedded in the source's domain          section 3.5, eqs (20), (21)
    2  patchwise blendshapes of the examples rebuild the source's expression: S_i^P      section 3.2.1, eqs (1), (2)
    3  the same weights blend the target's examples: T_i^P                               eq. (3)
       and adt carries over what they miss, the missing blendshape: T_i^M                section 3.2.2, eqs (4), (5)
    4  anacon makes the sum anatomically plausible: T_i                                  section 3.4, eqs (6), (19)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from retarget.anatomical_transfer import AnatomicalTransfer, AnatomySettings, Carrier, joined, without_template
from retarget.artistic import Edits
from retarget.check import check_frames
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
        adt = AnatomicalTransfer(pair, replace(self, collisions=self.collisions and self.missing_collisions))
        dt = DeformationTransfer.of(pair, Weighting.UNIFORM) if self.missing == Missing.DT else None
        return _Prepared(self, pair, patches, adt, dt, Evidence(pair, patches, self.evidence))


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
        adt = AnatomicalTransfer(back, self.rules)

        return embed_examples(target_examples, animation, pair.source_neutral, self.patches, self.rules.ridge, adt)

    def directed(self, edits: Mapping[str, Any] | None) -> Direction:
        """anacon, fwdSim after invSim on the target's own head, eq. (19), under artistic edits, section 4.6."""
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
class _Expression:
    """What became of one expression, by the names of the paper."""

    rebuilt: FloatArray  # S_i^P (n, 3) mm, after anacon if `source_anacon`
    missing: FloatArray  # T_i^M - T (n, 3) mm
    draft: FloatArray  # T_i^P + T_i^M - T (n, 3) mm
    result: FloatArray  # T_i (n, 3) mm
    solves: dict[str, SolveInfo]


@dataclass(frozen=True)
class _Fitted:
    prepared: _Prepared
    blendshapes: BlendshapeTransfer

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        pair, anacon = self.prepared.pair, self.prepared.directed(edits)
        source_frames = check_frames("source_frames", source_frames, len(pair.source_neutral))
        blended = self.blendshapes(source_frames)  # steps 2 and 3
        done = [
            self._expression(*of_one, anacon)
            for of_one in zip(source_frames, blended.source, blended.target, strict=True)
        ]

        def stacked(frames: list[FloatArray]) -> FloatArray:
            return np.array(frames).reshape(source_frames.shape)

        rebuilt = stacked([one.rebuilt for one in done])
        parts = {
            "source_reconstruction": rebuilt,
            "plbs": blended.target,
            "missing_source": source_frames - rebuilt,
            "missing_target": stacked([one.missing for one in done]),
            "draft": stacked([one.draft for one in done]),
        }
        return RetargetResult(stacked([one.result for one in done]), tuple(joined(one.solves) for one in done), parts)

    def _expression(
        self, expression: FloatArray, rebuilt: FloatArray, blended: FloatArray, anacon: Direction
    ) -> _Expression:
        """From S_i, S_i^P and T_i^P, (n, 3) mm each, to T_i."""
        method, pair, solves = self.prepared, self.prepared.pair, {}
        if method.rules.source_anacon:
            anacon_source = method.anacon_source
            smoothed = anacon_source.take(anacon_source.form(rebuilt))
            rebuilt, solves["source anacon"] = smoothed.skin, smoothed.info

        missing = pair.source_neutral + expression - rebuilt  # eq. (4): S_i^M
        carried, near = np.zeros_like(blended), None
        match method.rules.missing:
            case Missing.ADT:
                adt = method.adt.expression(missing, characteristics=method.rules.held != Held.NOTHING)
                carried, near, solves["adt"] = adt.skin - pair.target_neutral, adt.taken, adt.info  # eq. (5)
            case Missing.DT if method.dt is not None:
                carried = method.dt.displacements(missing[None])[0]
        draft = anacon.strengthened(blended + carried)

        result = draft
        if method.rules.anacon:
            result, solves["anacon"] = self._anacon(expression, rebuilt, draft, near, anacon)  # eqs (6), (19)
        return _Expression(rebuilt, carried, draft, result, solves)

    def _anacon(
        self, expression: FloatArray, rebuilt: FloatArray, draft: FloatArray, near: HeadState | None, anacon: Direction
    ) -> tuple[FloatArray, SolveInfo]:
        """T_i (n, 3) mm of a draft (n, 3) mm and how the solves went; `near`: a state of the target to start from."""
        method, rules = self.prepared, self.prepared.rules
        formed = anacon.form(draft, near)
        miss = method.evidence.miss(expression, rebuilt)
        detail = method.evidence.detail(anacon.unfollowed(draft, formed), miss) if rules.completed else 0.0 * draft
        wanted = None
        if rules.held != Held.NOTHING:
            wanted = anacon.characteristics(method.adt.characteristics(expression))
        if wanted is not None and rules.held == Held.EVIDENCE:
            wanted = method.evidence.held(wanted, draft, draft - detail, miss)
        done = anacon.take(formed, wanted, detail)
        return done.skin + detail, done.info
