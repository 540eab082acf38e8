"""What adt and anacon share: tissue that forms an expression on one head, applied to another (sections 3.3, 3.4).

adt(S_i^M, S, T)    = fwdSim(invSim(S_i^M, H_S), fc(S_i^M, S, T), H_T)        Algorithm 1
anacon(y, S_i, S, T) = fwdSim(invSim(y, H_T), fc(S_i, S, T), H_T)              eq. (19)
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from retarget.anatomy.template import check_size
from retarget.character import TetWeights, Topology, characters
from retarget.check import InvalidInput, check_frames
from retarget.simulation.bones import Jaw, size_ratio
from retarget.simulation.characteristics import Characteristics, FacialCharacteristics, LipForm
from retarget.simulation.forward import ForwardSettings, ForwardSimulation, ForwardState
from retarget.simulation.inverse import InverseSettings, InverseSimulation
from retarget.simulation.projective_dynamics import LENGTH_UNIT
from retarget.simulation.state import HeadState
from retarget.suggest import choose
from retarget.types import FloatArray, Pair, RetargetProblem, SolveInfo, Status

T = TypeVar("T")
Former = Callable[[FloatArray, HeadState | None], HeadState]  # an expression (n, 3) mm, and a state to start from
LEAST_WAY = 0.9  # of the lips' way: an expression is not given up for lips that cannot be parted, which is reported
SEVERITY = (Status.CONVERGED, Status.MAX_ITERATIONS, Status.FAILED)


@dataclass(frozen=True, kw_only=True)
class AnatomySettings:
    """The template's size and the weights of both simulations.

    template: `coarse` or `paper`. tissue_depth: factor on the table of soft-tissue depths. length_mm: unit of
    length, in mm, of the weights of squared distances; 10 reads the published ones in centimetres, as
    `retarget.simulation.weights` explains. tets: see `TetWeights`. lips: see `LipForm`. jaw: see `Jaw`. collisions:
    resolve those of the lips. streaming: frames are an animation in its order, and each solve starts from those
    before it: fewer iterations, and results that differ by the solver's tolerance.
    Raises InvalidInput for settings out of range.
    """

    template: str = "coarse"
    tissue_depth: float = 1.0
    length_mm: float = 10.0
    w_soft: float = 1.0  # w_S of eq. (14)
    w_muscle: float = 1.0  # w_M
    w_target: float = 100.0  # w_tar, per squared unit of length
    w_gradient_soft: float = 1.0  # w_nabla-S of eq. (18)
    w_gradient_muscle: float = 1.0  # w_nabla-M
    w_lip_contour: float = 10.0  # w_F of eq. (A.4), per squared unit of length
    w_eye_opening: float = 10.0  # w_F of eq. (A.2); areas relative to the neutral have no unit
    w_eye_socket: float = 10.0  # w_F of eq. (A.3)
    lips: LipForm | str = LipForm.RELATIVE
    tets: TetWeights | str = TetWeights.VOLUME
    jaw: Jaw | str = Jaw.JOINT
    collisions: bool = True
    streaming: bool = False

    def __post_init__(self) -> None:
        check_size(self.template)
        choose("lips", self.lips, LipForm)
        choose("tets", self.tets, TetWeights)
        choose("jaw", self.jaw, Jaw)
        for name in ("length_mm", "tissue_depth"):
            if not 0 < getattr(self, name) < np.inf:
                raise InvalidInput(f"{name}: expected a positive number, got {getattr(self, name)}.")
        self.inverse_settings, self.forward_settings  # noqa: B018  # raise for weights out of range

    @property
    def inverse_settings(self) -> InverseSettings:
        """Weights of eq. (14)."""
        return InverseSettings(self.w_soft, self.w_muscle, self.w_target * self._per_squared_length, jaw=self.jaw)

    @property
    def forward_settings(self) -> ForwardSettings:
        """Weights of eq. (18)."""
        return ForwardSettings(
            self.w_gradient_soft,
            self.w_gradient_muscle,
            self.w_lip_contour * self._per_squared_length,
            self.w_eye_opening,
            self.w_eye_socket,
            collisions=self.collisions,
            least_way=LEAST_WAY,
        )

    @property
    def _per_squared_length(self) -> float:
        return (LENGTH_UNIT / self.length_mm) ** 2


@dataclass(frozen=True)
class Carried:
    """An expression on the head that forms it and on the one that takes it over."""

    formed: HeadState  # invSim
    taken: ForwardState  # fwdSim

    @property
    def skin(self) -> FloatArray:
        """(n, 3) mm."""
        return self.taken.skin

    @property
    def info(self) -> SolveInfo:
        """Both solves as one: the worse status, iterations added up, the energy of the last."""
        return joined({"inverse": self.formed.info, "forward": self.taken.info})


@dataclass(frozen=True)
class Carrier:
    """fwdSim after invSim, for two heads of one template, which may be the same."""

    inverse: InverseSimulation
    forward: ForwardSimulation
    scale: float = 1.0  # BB(T) / BB(S), of the bones' translations
    collisions: bool = True  # resolve those of the lips, if the forward simulation does

    def take(self, formed: HeadState, wanted: Characteristics | None = None) -> Carried:
        """The same on the second head, eq. (10), held to characteristics."""
        gradients, bones = formed.gradients, formed.bones
        taken = self.forward(gradients, bones, self.scale, wanted, collisions=self.collisions)
        return Carried(formed, taken)


class AnatomicalTransfer:
    """adt of Algorithm 1 for a pair of neutrals, with heads fitted and systems factorised."""

    def __init__(self, pair: Pair, settings: AnatomySettings, collisions: bool = True) -> None:
        """collisions: False leaves lips where they are, whatever the settings.

        Raises InvalidInput for a topology without a template and for neutrals that no head can be made of.
        """
        self.pair, self.settings = pair, settings
        self.source, self.target = characters(pair, settings.template, settings.tissue_depth)  # eq. (7)
        self.characteristics = FacialCharacteristics(pair, settings.lips)  # eq. (9)
        self.carry = Carrier(
            self.source.inverse(settings.inverse_settings, settings.tets),
            self.target.forward(settings.forward_settings, settings.tets),
            size_ratio(pair.source_neutral, pair.target_neutral),
            collisions,
        )

    def started(self, characteristics: bool = True) -> Callable[[FloatArray], Carried]:
        """adt(expression, S, T) for source expressions (n, 3) mm, one at a time, as states of both heads."""
        form = former(self.carry.inverse, self.settings.streaming)

        def adt(expression: FloatArray) -> Carried:
            return self.carry.take(
                form(expression, None), self.characteristics(expression) if characteristics else None
            )

        return adt

    def __call__(self, frames: FloatArray) -> FloatArray:
        """Target expressions (t, n, 3) mm for source expressions (t, n, 3) mm.

        Raises InvalidInput where a simulation fails: a head at rest would pass for an answer.
        """
        frames = check_frames("source_frames", frames, len(self.pair.source_neutral))
        skins = np.empty(frames.shape)
        for number, state in enumerate(map(self.started(), frames)):
            if state.info.status is Status.FAILED:
                raise InvalidInput(
                    f"adt of expression {number}: expected a simulation that ends, {state.info.message}."
                )
            skins[number] = state.skin
        return skins


def former(inverse: InverseSimulation, streaming: bool) -> Former:
    """invSim, ready to form expressions one at a time; streaming: each starts from those before it too."""
    if not streaming:
        return inverse
    waiting, near = deque[FloatArray](), deque[HeadState | None]()
    states = inverse.stream(_drained(waiting), near=_drained(near))

    def form(expression: FloatArray, start: HeadState | None = None) -> HeadState:
        waiting.append(expression)
        near.append(start)
        return next(states)

    return form


def _drained(waiting: deque[T]) -> Iterator[T]:
    while True:
        yield waiting.popleft()


def joined(parts: Mapping[str, SolveInfo]) -> SolveInfo:
    """Several solves of one expression as one: the worst status, iterations added up, the energy of the last.

    The message names each with its status and iterations. No solve at all has converged.
    """
    if not parts:
        return SolveInfo()
    infos = list(parts.values())
    words = (
        f"{name} {info.status} in {info.iterations}" + (f" ({info.message})" if info.message else "")
        for name, info in parts.items()
    )
    worst = max((info.status for info in infos), key=SEVERITY.index)
    return SolveInfo(worst, sum(info.iterations for info in infos), infos[-1].energy, "; ".join(words))


def without_template(problem: RetargetProblem, size: str) -> str | None:
    """The reason why a topology has no volumetric head, or None."""
    try:
        Topology.of(problem.faces, problem.regions).template(size)
    except InvalidInput as error:
        return str(error)
    return None
