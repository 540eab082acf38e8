"""Rendered heads of a study: source, truth and every method with its vertex error, on one scale in mm."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from reports.bust import bust_with
from reports.camera import Camera, look
from reports.load import FigureCell, Frames, MethodFacts, StudyResults
from reports.render import render_mesh, write_image
from reports.text import entry
from retarget.types import FloatArray, IntArray

STORED = 2e-5  # mm: frames are kept in single precision, so that a smaller error is none
SIZE = (216, 264)  # pixels of one head: 270 per inch at 20 mm
TURN, RAISE = 24.0, 3.0  # degrees from which a head is seen
_PARTS = {  # named parts of a result, in the order of Figs 12 and 13: label, what a displacement is added to
    "source_reconstruction": ("source rebuilt", None),
    "missing_source": ("missing, source", "source_neutral"),
    "lbs": ("blendshapes", None),
    "plbs": ("patchwise blendshapes", None),
    "missing_target": ("missing, target", "target_neutral"),
    "draft": ("sum of both", None),
}
_COMPARED = ("lbs", "plbs", "draft")  # parts that are the target's expression and so have an error
PEERS = ("lbs", "landmark_dt", "sumner_popovic", "ebfr", "alm", "adt", "anacondar")  # of Figs 5 and 6, in order
_REBUILT = ("anacondar", "plbs", "plbs_residual", "anacondar_paper")  # whose patchwise reconstruction is shown
_SOURCE_PART = "source_reconstruction"
_STILL = 0.35  # of the largest motion: a vertex that moves less does not decide how low the picture reaches
_FACE = 0.06  # of the largest motion: what moves less is the back of the head, and a picture may cut it


@dataclass(frozen=True)
class Head:
    """One picture of a page; image is a file name, or None where there is no result."""

    label: str
    image: str | None
    caption: str = ""  # its mean error with the unit


@dataclass(frozen=True)
class HeadRow:
    """One expression."""

    expression: str
    heads: tuple[Head, ...]


@dataclass(frozen=True)
class HeadPage:
    """A grid: expressions x methods for one pair and example count."""

    source: str
    target: str
    n_examples: int
    draw: int
    rows: tuple[HeadRow, ...]


@dataclass(frozen=True)
class HeadPages:
    """All grids of a study with their common scale."""

    limit_mm: float
    pages: tuple[HeadPage, ...] = ()
    peers: tuple[HeadPage, ...] = ()  # in the manner of Figs 5 and 6
    parts: tuple[HeadPage, ...] = ()  # of one method
    worst: tuple[HeadRow, ...] = ()


@dataclass
class _Darkroom:
    """Pictures asked for, each once, taken together at the end by a few processes."""

    folder: Path
    prefix: str
    limit: float
    orders: dict[str, tuple[Path, FloatArray, Frames, Camera, tuple[int, int], FloatArray | None, float]] = field(
        default_factory=dict
    )

    def order(
        self, vertices: FloatArray, frames: Frames, camera: Camera, size: tuple[int, int], error: FloatArray | None
    ) -> str:
        """The file of a picture; one that several pages show is taken once."""
        seen = hashlib.sha256(repr((camera, size)).encode())
        for array in (vertices, frames.faces, *(() if error is None else (error,))):
            seen.update(np.ascontiguousarray(array).tobytes())
        file = f"{self.prefix}-{seen.hexdigest()[:20]}.jpg"
        self.orders.setdefault(file, (self.folder / file, vertices, frames, camera, size, error, self.limit))
        return file

    def develop(self) -> None:
        jobs = min(os.cpu_count() or 1, 8, max(len(self.orders) // 8, 1))
        Parallel(n_jobs=jobs)(
            delayed(_take)(path, vertices, frames.faces, *rest)
            for path, vertices, frames, *rest in self.orders.values()
        )


def error_limit(studies: Sequence[StudyResults]) -> float:
    """Upper end in mm of the one scale on which errors of studies are coloured; 1 without any error.

    Of all kept cells that a method made, and that are not exact, the middle one has its worst three hundredths at two
    thirds of the scale: better ones still show colour, and the worst may saturate.
    """
    made = [cell for study in studies for cell in study.figure_cells if cell.method in study.tested]
    large = [float(np.nanquantile(_errors(cell), 0.97)) for cell in made]
    shown = [value for value in large if value > STORED]
    return nice(1.5 * float(np.median(shown))) if shown else 1.0


def render_heads(
    study: StudyResults, folder: Path, prefix: str, expressions: int = 4, limit: float | None = None
) -> HeadPages | None:
    """Render a study's figure cells into folder; None if it kept no frames.

    limit: upper end of the colours in mm, for conditions of one another the same; by default the study's own.

    The pages show the first pair with frames at the smallest and the largest example count, and the `expressions`
    that move the truth most; `worst` shows the single worst expression of each method among all figure cells.
    """
    cells = study.figure_cells
    if not cells:
        return None
    counts = sorted({c.n_examples for c in cells})
    first = next((c for c in cells if c.method == study.facts["reference"]), cells[0])
    limit = error_limit([study]) if limit is None else limit
    darkroom = _Darkroom(folder, prefix, limit)
    shown = [m for m in study.methods if m.name != "neutral"]
    kept = tuple(dict.fromkeys((counts[0], counts[-1])))
    pages = tuple(_page(study, darkroom, first, count, expressions, shown) for count in kept)
    peers = tuple(page for count in kept for page in _peer_page(study, darkroom, first, count, expressions))
    part_pages = tuple(_part_pages(study, darkroom, first, expressions))
    worst = tuple(_worst(study, darkroom, cells))
    darkroom.develop()
    return HeadPages(limit, pages, peers, part_pages, worst)


def _at(study: StudyResults, first: FigureCell, count: int) -> dict[str, FigureCell]:
    """The kept cells of one pair, draw and example count by method."""
    at = (first.source, first.target, count, first.draw)
    return {c.method: c for c in study.figure_cells if (c.source, c.target, c.n_examples, c.draw) == at}


def _peer_page(
    study: StudyResults, room: _Darkroom, first: FigureCell, count: int, expressions: int
) -> Iterator[HeadPage]:
    """Figs 5 and 6: source, its patchwise reconstruction with what that misses, the peers, the truth; results plain.

    On the ADT result lies its distance from the AnaConDaR result. Nothing for a study with fewer than two peers.
    """
    chosen = [m for name in PEERS for m in study.methods if m.name == name]
    if len(chosen) < 2:
        return
    shown = _at(study, first, count)
    frames = first.frames
    camera = _camera(frames, SIZE)
    rebuilt = next((shown[n].frames for n in _REBUILT if n in shown and _SOURCE_PART in shown[n].frames.parts), None)
    rows = []
    for t in lively(frames, expressions):
        heads = [Head(f"source {first.source}", room.order(frames.source[t], frames, camera, SIZE, None))]
        if rebuilt is not None:
            skin = rebuilt.parts[_SOURCE_PART][t]
            missed = frames.distance(skin, frames.source[t])
            image = room.order(skin, frames, camera, SIZE, missed)
            heads.append(Head("source rebuilt", image, _said(missed)))
        for m in chosen:
            if m.name not in shown:
                heads.append(Head(m.label, None, "no result"))
                continue
            mine, apart = shown[m.name].frames, None
            if m.name == "adt" and "anacondar" in shown:
                apart = frames.distance(mine.retargeted[t], shown["anacondar"].frames.retargeted[t])
            image = room.order(mine.retargeted[t], frames, camera, SIZE, apart)
            heads.append(Head(m.label, image, _said(mine.error(t))))
        heads.append(Head(f"truth {first.target}", room.order(frames.truth[t], frames, camera, SIZE, None)))
        rows.append(HeadRow(frames.expressions[t], tuple(heads)))
    yield HeadPage(first.source, first.target, count, first.draw, tuple(rows))


def _page(
    study: StudyResults,
    room: _Darkroom,
    first: FigureCell,
    count: int,
    expressions: int,
    methods: Sequence[MethodFacts],
) -> HeadPage:
    shown = _at(study, first, count)
    frames = first.frames
    camera = _camera(frames, SIZE)
    rows = []
    for t in lively(frames, expressions):
        heads = [
            Head(f"source {first.source}", room.order(frames.source[t], frames, camera, SIZE, None)),
            Head(f"truth {first.target}", room.order(frames.truth[t], frames, camera, SIZE, None)),
        ]
        for m in methods:
            if m.name not in shown:
                heads.append(Head(m.label, None, "no result"))
                continue
            mine = shown[m.name].frames
            error = mine.error(t)
            image = room.order(mine.retargeted[t], mine, camera, SIZE, error)
            heads.append(Head(m.label, image, _said(error)))
        rows.append(HeadRow(frames.expressions[t], tuple(heads)))
    return HeadPage(first.source, first.target, count, first.draw, tuple(rows))


def _part_pages(study: StudyResults, room: _Darkroom, first: FigureCell, expressions: int) -> Iterator[HeadPage]:
    """What became of an expression on its way through one method, at each example count."""
    name = study.facts.get("parts")
    for cell in study.figure_cells:
        same = (cell.source, cell.target, cell.draw) == (first.source, first.target, first.draw)
        if cell.method != name or not same or not cell.frames.parts:
            continue
        frames = cell.frames
        camera = _camera(frames, SIZE)
        rows = []
        for t in lively(frames, expressions):
            heads = [Head("source", room.order(frames.source[t], frames, camera, SIZE, None))]
            for part, (label, base) in _PARTS.items():
                if part not in frames.parts:
                    continue
                shown = frames.parts[part] + (getattr(frames, base) if base else 0.0)
                error = frames.error(t, shown) if part in _COMPARED else None
                image = room.order(shown[t], frames, camera, SIZE, error)
                heads.append(Head(label, image, "" if error is None else _said(error)))
            error = frames.error(t)
            image = room.order(frames.retargeted[t], frames, camera, SIZE, error)
            heads.append(Head("result", image, _said(error)))
            heads.append(Head("truth", room.order(frames.truth[t], frames, camera, SIZE, None)))
            rows.append(HeadRow(frames.expressions[t], tuple(heads)))
        yield HeadPage(cell.source, cell.target, cell.n_examples, cell.draw, tuple(rows))


def _worst(study: StudyResults, room: _Darkroom, cells: Sequence[FigureCell]) -> Iterator[HeadRow]:
    for m in study.methods:
        mine = [c for c in cells if c.method == m.name]
        if m.kind == "reference" or not mine:
            continue
        cell, t = max(((c, t) for c in mine for t in range(len(c.frames.truth))), key=lambda ct: _mean(*ct))
        frames = cell.frames
        camera = _camera(frames, SIZE)
        error = frames.error(t)
        heads = (
            Head("source", room.order(frames.source[t], frames, camera, SIZE, None)),
            Head("truth", room.order(frames.truth[t], frames, camera, SIZE, None)),
            Head("result", room.order(frames.retargeted[t], frames, camera, SIZE, None)),
            Head(
                "error",
                room.order(frames.retargeted[t], frames, camera, SIZE, error),
                _said(error),
            ),
        )
        title = f"{m.label}: {frames.expressions[t]}, {cell.source} to {cell.target}, {cell.n_examples} examples"
        yield HeadRow(title, heads)


def _said(error: FloatArray) -> str:
    """The mean of an error (n,) mm with NaN where nothing is measured, as printed below a head."""
    mean = float(np.nanmean(error))
    return "exact" if mean <= STORED else f"{entry(mean, 2)} mm"


def _mean(cell: FigureCell, frame: int) -> float:
    return float(np.nanmean(cell.frames.error(frame)))


def _errors(cell: FigureCell) -> FloatArray:
    return np.stack([cell.frames.error(t) for t in range(len(cell.frames.truth))])


def lively(frames: Frames, count: int) -> list[int]:
    """Indices of the frames that move most, in their own order."""
    motion = np.linalg.norm(frames.truth - frames.target_neutral, axis=2).mean(axis=1)
    return sorted(np.argsort(-motion, kind="stable")[:count].tolist())


def _camera(frames: Frames, size: tuple[int, int]) -> Camera:
    """A view that holds both faces in all frames: the same for all pictures of a grid."""
    return look(_faces(frames), size, turn=TURN, raise_=RAISE, margin=0.04)


def _faces(frames: Frames) -> FloatArray:
    """(m, 3) mm: what is `framed`, without what lies beside, above and behind the parts that move."""
    motion = np.linalg.norm(frames.truth - frames.target_neutral, axis=2).max(axis=0)
    face = motion > _FACE * float(motion.max())
    points = framed(frames)
    if not face.any():
        return points
    moving = np.concatenate([skin[face] for skin in (*frames.source, *frames.truth)])
    return points[((points >= moving.min(axis=0)) & (points <= moving.max(axis=0))).all(axis=1)]


def framed(frames: Frames) -> FloatArray:
    """(m, 3) mm: points of both heads, in all frames, down to the lowest vertex that moves."""
    heads = [frames.source_neutral, frames.target_neutral, *frames.source, *frames.truth]
    motion = np.linalg.norm(frames.truth - frames.target_neutral, axis=2).max(axis=0)
    moving = np.flatnonzero(motion > _STILL * float(motion.max()))
    points = np.concatenate(heads).astype(np.float64)
    floor = min(float(h[moving, 1].min()) for h in heads) if len(moving) else float(points[:, 1].min())
    return points[points[:, 1] >= floor - 4.0]


def nice(value: float) -> float:
    """The next larger of 1, 1.5, 2, 3, 4, 5, 7 times a power of ten."""
    if not np.isfinite(value) or value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 1.5, 2, 3, 4, 5, 7, 10) if step * power >= value * (1 - 1e-9)))


def _take(
    path: Path,
    vertices: FloatArray,
    faces: IntArray,
    camera: Camera,
    size: tuple[int, int],
    error: FloatArray | None,
    limit: float,
) -> None:
    limits = None if error is None else (0.0, limit)
    values = np.full(len(vertices), np.nan) if error is None else error
    head, triangles, shown = bust_with(np.asarray(vertices, dtype=np.float64), faces, values)
    picture = render_mesh(head, triangles, camera, size, vertex_values=None if error is None else shown, limits=limits)
    write_image(path, picture)
