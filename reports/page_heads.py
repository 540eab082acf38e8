"""Heads for the viewer of the page: meshes on a lattice, packed small, as text.

Coordinates are integers of `STEP` mm. Truths and sources are stored as the motion away from their neutral, results as
what they differ from the truth by, so that an error shown is within 0.01 mm of the measured one. Of every array only
the difference to a neighbour on the mesh is kept, by planes of bytes, deflated.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from reports.camera import look
from reports.figures import row_color
from reports.heads import RAISE, TURN, framed, lively
from reports.load import FigureCell, Frames, StudyResults
from reports.render import sky_share
from reports.text import number
from retarget.check import InvalidInput
from retarget.types import IntArray

STEP = 0.01  # mm: a coordinate is within half of it, a distance within 0.01 mm
BUDGET = 14_000_000  # characters of text for all heads of a page
ASPECT = (4, 5)  # of a panel
VIEW = (TURN, RAISE)
SHOWN = 4  # methods that are shown at first, beside source and truth

Scene = tuple[str, str, int]  # source, target, draw


@dataclass(frozen=True)
class Packed:
    """The heads of one study: `facts` for the viewer, and the arrays that its numbers stand for."""

    facts: dict[str, Any]
    arrays: tuple[str, ...]


@dataclass
class _Store:
    """Arrays as text, numbered in the order in which they came; `first` is the number of the first."""

    first: int
    arrays: list[str] = field(default_factory=list)

    @property
    def size(self) -> int:
        return sum(map(len, self.arrays))

    def put(self, text: str) -> int:
        self.arrays.append(text)
        return self.first + len(self.arrays) - 1


@dataclass(frozen=True)
class Walk:
    """A way over all vertices of a mesh on which each but the first has a neighbour that came before."""

    order: IntArray  # (n,) vertices
    before: IntArray  # (n,) place in `order` of the neighbour; the first is its own

    @classmethod
    def over(cls, faces: IntArray, count: int) -> Walk:
        """Breadth first from vertex 0; pieces that hang together nowhere are reached from it."""
        edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        piece = connected_components(_graph(edges, count), directed=False)[1]
        starts = np.unique(piece, return_index=True)[1]
        joined = np.concatenate([edges, np.column_stack([np.zeros_like(starts), starts])])
        order, parents = breadth_first_order(_graph(joined, count), 0, directed=False)
        place = np.empty(count, dtype=np.int64)
        place[order] = np.arange(count)
        parents[0] = 0
        return cls(order.astype(np.int64), place[parents[order]])

    def steps(self, values: IntArray) -> IntArray:
        """(t, n, 3) differences along the way of values (t, n, 3) given by vertex."""
        ordered = values[:, self.order]
        steps = ordered - ordered[:, self.before]
        steps[:, 0] = ordered[:, 0]
        return steps


def _graph(edges: IntArray, count: int) -> Any:
    return coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()


def pack(values: ArrayLike) -> str:
    """Integers as text: zigzag, as many planes of bytes as the largest needs, deflated, base64.

    Positive and negative numbers share the low planes, so that small steps leave the high ones empty.
    """
    flat = np.asarray(values, dtype=np.int64).ravel()
    if len(flat) and np.abs(flat).max() >= 1 << 30:
        raise InvalidInput(
            f"page: expected coordinates below {(1 << 30) * STEP / 1000:,.0f} m, got "
            f"{np.abs(flat).max() * STEP / 1000:,.0f} m; a result of this study is no head."
        )
    zigzag = ((flat << 1) ^ (flat >> 63)).astype("<u4")
    planes = np.ascontiguousarray(zigzag.view(np.uint8).reshape(-1, 4).T)
    used = 1 + max((i for i in range(4) if planes[i].any()), default=0)
    return base64.b64encode(bytes([used]) + zlib.compress(planes[:used].tobytes(), 6)).decode("ascii")


def pack_heads(study: StudyResults, limit_mm: float, first: int = 0, budget: int = BUDGET) -> Packed | None:
    """The kept frames of a study for the viewer; None if it kept none.

    `limit_mm` is the end of the colour scale, `first` the number of the first array. Pairs come in the study's order,
    and of each the smallest, the largest and then the other example counts, until `budget` characters are used; the
    facts name what had no room.
    """
    cells = study.figure_cells
    if not cells:
        return None
    heads = _Heads(study, _Store(first), budget)
    left_out = [cell for cell in _by_priority(cells) if not heads.take(cell)]
    return Packed(
        {
            "label": study.differs,
            "limit": limit_mm,
            "step": STEP,
            "view": VIEW,
            "vertices": len(cells[0].frames.target_neutral),
            "methods": [
                {"name": m.name, "label": m.label, "kind": m.kind, "color": row_color(study, m)}
                for m in study.methods
                if any(cell.method == m.name for cell in cells)
            ],
            "shown": _shown_first(study, {cell.method for cell in cells}),
            "counts": sorted({cell.n_examples for cell in cells}),
            **heads.topology,
            "scenes": list(heads.scenes.values()),
            "left_out": _said(left_out, len(cells)),
        },
        tuple(heads.store.arrays),
    )


@dataclass
class _Heads:
    study: StudyResults
    store: _Store
    budget: int
    scenes: dict[Scene, dict[str, Any]] = field(default_factory=dict)
    truths: dict[Scene, NDArray[Any]] = field(default_factory=dict)
    skies: dict[str, int] = field(default_factory=dict)

    @cached_property
    def walk(self) -> Walk:
        frames = self.study.figure_cells[0].frames
        return Walk.over(np.asarray(frames.faces, dtype=np.int64), len(frames.target_neutral))

    @cached_property
    def topology(self) -> dict[str, int]:
        frames = self.study.figure_cells[0].frames
        return {
            "order": self.store.put(pack(np.diff(self.walk.order, prepend=0))),
            "before": self.store.put(pack(np.diff(self.walk.before, prepend=0))),
            "faces": self.store.put(pack(np.diff(frames.faces.astype(np.int64).ravel(), prepend=0))),
            "head": self.store.put(pack(np.diff(frames.head.astype(np.int64), prepend=0))),
        }

    def take(self, cell: FigureCell) -> bool:
        """Add a cell; False where there is no room for it."""
        key = (cell.source, cell.target, cell.draw)
        frames = cell.frames
        result = self._packed(_lattice(frames.retargeted, frames.truth))
        if self.topology and self.store.size + len(result) > self.budget:
            return False
        if key not in self.scenes:
            self.scenes[key] = self._scene(key, frames)
            self.truths[key] = frames.truth
        elif not np.array_equal(self.truths[key], frames.truth):
            return False  # other test expressions than the first cell of this pair
        errors = [float(np.nanmean(frames.error(t))) for t in range(len(frames.truth))]
        self.scenes[key]["results"].setdefault(str(cell.n_examples), {})[cell.method] = {
            "delta": self.store.put(result),
            "errors": [number(error, 2) for error in errors],
            "mean": number(float(np.mean(errors)), 2),
        }
        return True

    def _scene(self, key: Scene, frames: Frames) -> dict[str, Any]:
        camera = look(framed(frames), ASPECT, *VIEW, margin=0.05)
        return {
            "source": key[0],
            "target": key[1],
            "draw": key[2],
            "expressions": list(frames.expressions),
            "liveliest": 1 + lively(frames, 1)[0],
            "target_point": [round(float(x), 1) for x in camera.target],
            "distance": round(float(np.linalg.norm(np.subtract(camera.eye, camera.target))), 1),
            "neutrals": self.store.put(
                self._packed(_lattice(np.stack([frames.source_neutral, frames.target_neutral]), 0.0))
            ),
            "skies": [self._sky(key[0], frames.source_neutral), self._sky(key[1], frames.target_neutral)],
            "motion": self.store.put(self._packed(_lattice(frames.source, frames.source_neutral))),
            "truth": self.store.put(self._packed(_lattice(frames.truth, frames.target_neutral))),
            "results": {},
        }

    def _sky(self, name: str, neutral: NDArray[Any]) -> int:
        """How much light reaches each vertex, in 255ths along the walk: what is dark on the neutral stays dark."""
        if name not in self.skies:
            share = np.rint(255 * sky_share(neutral, self.study.figure_cells[0].frames.faces))
            self.skies[name] = self.store.put(pack(np.diff(share.astype(np.int64)[self.walk.order], prepend=0)))
        return self.skies[name]

    def _packed(self, values: IntArray) -> str:
        return pack(self.walk.steps(values).transpose(0, 2, 1))


def _lattice(values: ArrayLike, origin: ArrayLike) -> IntArray:
    return np.rint(np.subtract(values, origin, dtype=np.float64) / STEP).astype(np.int64)


def _by_priority(cells: Sequence[FigureCell]) -> Iterator[FigureCell]:
    """Pair by pair; of each the smallest count, the largest, the others; methods in the order of the table."""
    counts = sorted({cell.n_examples for cell in cells})
    ranked = list(dict.fromkeys([counts[0], counts[-1], *counts]))
    scenes = list(dict.fromkeys((cell.source, cell.target, cell.draw) for cell in cells))
    return iter(sorted(cells, key=lambda c: (scenes.index((c.source, c.target, c.draw)), ranked.index(c.n_examples))))


def _shown_first(study: StudyResults, kept: set[str]) -> list[str]:
    """The reference, the end of the primary family, then whatever is there, in the order of the table."""
    wanted = [study.facts["reference"], *reversed(study.facts["primary_family"]), *study.tested]
    chosen = [name for name in dict.fromkeys(wanted) if name in kept][:SHOWN]
    return [m.name for m in study.methods if m.name in chosen]


def _said(left_out: Sequence[FigureCell], total: int) -> str:
    if not left_out:
        return ""
    groups: dict[str, list[str]] = {}
    for cell in left_out:
        groups.setdefault(f"{cell.source} to {cell.target}, {cell.n_examples} examples", []).append(cell.method)
    named = "; ".join(f"{where} ({len(methods)})" for where, methods in groups.items())
    return f"{len(left_out)} of {total} kept results had no room on this page: {named}."
