"""The protocol between data, methods and studies: what a method may know and what it must answer.

Lengths are millimetres, right-handed, +y up, +z out of the face, everywhere in this project.
`n` counts vertices, `f` triangles, `k` examples, `N` animation frames, `t` frames to retarget.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class AffinePoint:
    """A point that follows the skin without lying on it, such as a jaw joint: an affine combination of vertices."""

    indices: IntArray  # (m,)
    weights: FloatArray  # (m,) that sum to one, so that the point moves with the head

    def __call__(self, vertices: FloatArray) -> FloatArray:
        """(..., 3) mm on vertices (..., n, 3) mm."""
        return self.weights @ vertices[..., self.indices, :]


@dataclass(frozen=True)
class Regions:
    """Named parts of one topology, shared by every identity in it.

    vertices   name -> (m,) sorted vertex indices, e.g. ``head``, ``face``, ``cranium``
    loops      name -> (m,) vertex indices in order round a closed loop, e.g. ``lip_contour``
    triangles  name -> (m,) indices into ``faces``, e.g. ``eye_socket_left``
    patches    name -> (m, 3) triangles that need not be faces: the supplementary meshes of AnaConDaR (Fig. 4),
               e.g. ``eye_opening_left``
    landmarks  name -> vertex index
    points     name -> point off the skin, e.g. ``condyle_left``
    mirror     (n,) index of each vertex's mirror image, or None if unknown
    """

    vertices: Mapping[str, IntArray] = field(default_factory=dict)
    loops: Mapping[str, IntArray] = field(default_factory=dict)
    triangles: Mapping[str, IntArray] = field(default_factory=dict)
    patches: Mapping[str, IntArray] = field(default_factory=dict)
    landmarks: Mapping[str, int] = field(default_factory=dict)
    points: Mapping[str, AffinePoint] = field(default_factory=dict)
    mirror: IntArray | None = None


@dataclass(frozen=True)
class Pair:
    """Two characters in one topology: all that `Retargeter.prepare` may see."""

    faces: IntArray  # (f, 3)
    source_neutral: FloatArray  # (n, 3) mm
    target_neutral: FloatArray  # (n, 3) mm
    regions: Regions = field(default_factory=Regions)


@dataclass(frozen=True)
class Examples:
    """Expressions of the target, and of the source where the correspondence is known."""

    target: FloatArray  # (k, n, 3) mm, k may be 0
    source: FloatArray | None  # (k, n, 3) mm, or None: no correspondence is known (AnaConDaR section 3.5)

    @property
    def count(self) -> int:
        return len(self.target)


@dataclass(frozen=True)
class RetargetProblem:
    """All that a method may know: a pair, the source's animation and the examples."""

    faces: IntArray  # (f, 3), shared by source and target
    source_neutral: FloatArray  # (n, 3) mm
    target_neutral: FloatArray  # (n, 3) mm
    source_animation: FloatArray  # (N, n, 3) mm: the animation S, also the span of the example embedding
    target_examples: FloatArray  # (k, n, 3) mm, k may be 0
    source_examples: FloatArray | None = None  # (k, n, 3) mm, or None: no correspondence is known
    regions: Regions = field(default_factory=Regions)

    @staticmethod
    def of(pair: Pair, examples: Examples, animation: FloatArray) -> RetargetProblem:
        """animation: (N, n, 3) mm of the source."""
        return RetargetProblem(
            pair.faces,
            pair.source_neutral,
            pair.target_neutral,
            animation,
            examples.target,
            examples.source,
            pair.regions,
        )

    @property
    def pair(self) -> Pair:
        return Pair(self.faces, self.source_neutral, self.target_neutral, self.regions)

    @property
    def examples(self) -> Examples:
        return Examples(self.target_examples, self.source_examples)


class Status(StrEnum):
    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    FAILED = "failed"


@dataclass(frozen=True)
class SolveInfo:
    """How a solve ended; it travels with the answer into the record."""

    status: Status = Status.CONVERGED
    iterations: int = 1
    energy: tuple[float, ...] = ()  # history, without dimension unless the method's page says otherwise
    message: str = ""


@dataclass(frozen=True)
class RetargetResult:
    """frames (t, n, 3) mm; info holds one entry per frame; parts are named intermediate frames (t, n, 3)
    where a method has them: ``source_reconstruction``, ``plbs``, ``missing_source``, ``missing_target``, ..."""

    frames: FloatArray
    info: tuple[SolveInfo, ...]
    parts: Mapping[str, FloatArray] = field(default_factory=dict)


@runtime_checkable
class Fitted(Protocol):
    """A method that has seen its examples. The call is timed per expression."""

    def __call__(self, source_frames: FloatArray, edits: Mapping[str, Any] | None = None) -> RetargetResult:
        """Retarget source_frames (t, n, 3) mm. ``edits`` are artistic edits; a method refuses what it lacks."""
        ...


@runtime_checkable
class Prepared(Protocol):
    """A method that knows a pair of characters."""

    def fit(self, examples: Examples, animation: FloatArray) -> Fitted:
        """Example-dependent set-up; animation is (N, n, 3) mm."""
        ...


class Retargeter(ABC):
    """A method: a frozen dataclass of hyper-parameters that Hydra makes from ``conf/method/*.yaml``.

    `prepare` and `fit` return new objects, so nothing is ever half initialised, and the two set-ups and
    the cost per frame separate by themselves. Anything random has a ``seed`` field.
    """

    control: ClassVar[bool] = False  # a row that isolates the effect of one part, proposed by nobody as a method
    needs_examples: ClassVar[bool] = True  # False: whatever examples and animation it is given, the frames are the same
    exact_on_self: ClassVar[bool] = False  # claims that source == target, examples included, gives the source's frames

    def unsupported(self, problem: RetargetProblem) -> str | None:
        """The reason why this method cannot serve the problem (shown in reports as a cell), or None."""
        return None

    @abstractmethod
    def prepare(self, pair: Pair) -> Prepared:
        """Set-up that depends on the two neutrals, the faces and the regions alone."""

    def retarget(self, problem: RetargetProblem, source_frames: FloatArray) -> RetargetResult:
        """The one-call form: check, prepare, fit, retarget source_frames (t, n, 3) mm.

        Raises InvalidInput for data that no method can use, UnsupportedProblem where `unsupported` has a reason.
        """
        from retarget.check import UnsupportedProblem, check_frames, check_problem

        problem = check_problem(problem)
        frames = check_frames("source_frames", source_frames, len(problem.source_neutral))
        if reason := self.unsupported(problem):
            raise UnsupportedProblem(f"{type(self).__name__} cannot serve this problem: {reason}")
        return self.prepare(problem.pair).fit(problem.examples, problem.source_animation)(frames)
