"""One (source, target) pair of a study: prepare each method once, then loop over example counts and draws."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from experiments.correspondence import Correspondence, Found, Known, correspondences
from experiments.memory import peak_memory_mb
from experiments.metrics.metric import Comparison, Disturbed, Measurement, Metric
from experiments.record import FRAMES, SCHEMA, Record, write_record
from experiments.references import REFERENCES, PreparedReference
from experiments.study import Row, Study
from reports.cells import METRIC_COLUMNS
from retarget.check import InvalidInput
from retarget.io.files import write_whole
from retarget.types import (
    FloatArray,
    Pair,
    Prepared,
    RetargetProblem,
    RetargetResult,
    SolveInfo,
    Status,
)
from synth_data.dataset import Dataset


@dataclass(frozen=True)
class Cell:
    """One row of the table, on one pair, with one draw of n_examples examples."""

    id: str
    row: Row
    correspondence: str
    source: str
    target: str
    n_examples: int
    draw: int
    keep_frames: bool = False


@dataclass(frozen=True)
class PairTask:
    """The cells of one pair that are still to be computed, with all that they need."""

    study: Study
    dataset: Dataset
    metrics: tuple[Metric, ...]
    cells: tuple[Cell, ...]
    folder: Path
    code: str


@dataclass(frozen=True)
class _Case:
    """What one draw and example count ask of every method."""

    problem: RetargetProblem  # its source examples are still to be filled in
    known: Known
    source: FloatArray  # (t, n, 3) mm, to be retargeted, as scanned
    performed: FloatArray  # (t, n, 3) mm, the same without the scanner's noise, never shown to a method
    truth: FloatArray  # (t, n, 3) mm, never shown to a method
    expressions: tuple[str, ...]
    noise: FloatArray | None  # (k, n, 3) mm, see `Study.noise`


@dataclass(frozen=True)
class _Answer:
    result: RetargetResult
    disturbed: FloatArray | None  # (k, n, 3) mm, the answer to the source with the noise of the case
    found: Found
    fit_seconds: float
    seconds_per_expression: float


class _Refused(Exception):
    """A method has a reason not to serve a problem."""


class _Unprepared(Exception):
    """A method could not be set up for a pair."""


def evaluate_pair(task: PairTask) -> int:
    """Compute and record every cell of the task; returns their number."""
    first = task.cells[0]
    source = _Performer(task.dataset, first.source)
    target = _Performer(task.dataset, first.target)
    pair = Pair(task.dataset.faces, source.scanned_neutral, target.scanned_neutral, task.dataset.regions)
    clean = replace(pair, source_neutral=source.neutral, target_neutral=target.neutral)
    noise = task.study.noise(task.dataset, first.source)
    asked = {cell.correspondence for cell in task.cells}
    found = correspondences(pair, asked, task.study.embedding, task.study.rigging)
    for row, cells in _by_row(task.cells):
        prepared, prepare_seconds = _prepare(row, pair, clean)
        known: dict[tuple[str, int], _Answer] = {}  # of a method that needs no examples
        for cell in cells:
            case = _case(task.study, cell, pair, source, target, noise)
            answer: _Answer | None = None
            try:
                at = cell.correspondence, cell.draw
                answer = known.get(at) or _answer(row, prepared, case, found[cell.correspondence])
                if row.method is not None and not row.method.needs_examples:
                    known[at] = answer
                status, reason = _verdict(answer.result)
            except _Refused as refusal:
                status, reason = "unsupported", str(refusal)
            except _Unprepared as failure:
                status, reason = "failed", str(failure)
            except Exception as error:  # a method's failure is a result of the study, never its end
                status, reason = "failed", f"{type(error).__name__}: {error}"
            timings = {
                "prepare_seconds": prepare_seconds,
                "correspondence_seconds": answer and answer.found.seconds,
                "fit_seconds": answer and answer.fit_seconds,
                "seconds_per_expression": answer and answer.seconds_per_expression,
            }
            _record(task, cell, case, clean, answer, status, reason, timings)
    return len(task.cells)


def _by_row(cells: Sequence[Cell]) -> list[tuple[Row, list[Cell]]]:
    rows: dict[str, tuple[Row, list[Cell]]] = {}
    for cell in cells:
        rows.setdefault(cell.row.name, (cell.row, []))[1].append(cell)
    return list(rows.values())


class _Performer:
    """An identity of the dataset and its performance of all expressions, in truth and as scanned, once per pair."""

    def __init__(self, dataset: Dataset, identity: str) -> None:
        self.names = dataset.expressions
        self.neutral = dataset.neutral(identity)
        self.performance = dataset.frames(identity, range(len(self.names)))
        self.scanned_neutral = dataset.scanned_neutral(identity)
        self.scans = dataset.as_scanned(identity, self.names, self.performance)


def _case(
    study: Study, cell: Cell, pair: Pair, source: _Performer, target: _Performer, noise: FloatArray | None
) -> _Case:
    drawn = study.draw(cell.source, cell.target, cell.draw, len(source.names))
    examples, test = list(drawn.examples(cell.n_examples)), list(drawn.test)
    five = study.span == "five"
    known = Known(
        names=tuple(source.names[i] for i in examples),
        source_examples=source.scans[examples],
        target_examples=target.scans[examples],
        animation=source.scans[test] if five else source.scans,
        span=f"draw {cell.draw}" if five else "animation",
        method=cell.row.method,
    )
    return _Case(
        problem=RetargetProblem(
            faces=pair.faces,
            source_neutral=pair.source_neutral,
            target_neutral=pair.target_neutral,
            source_animation=known.animation,
            target_examples=known.target_examples,
            regions=pair.regions,
        ),
        known=known,
        source=source.scans[test],
        performed=source.performance[test],
        truth=target.performance[test],
        expressions=tuple(source.names[i] for i in drawn.test),
        noise=noise,
    )


def _prepare(row: Row, pair: Pair, clean: Pair) -> tuple[Prepared | PreparedReference | str, float | None]:
    """(prepared or why it failed, seconds); a reference, which knows the truth, starts from clean neutrals."""
    start = time.perf_counter()
    try:
        prepared = REFERENCES[row.name](clean) if row.method is None else row.method.prepare(pair)
    except Exception as error:
        return f"prepare: {type(error).__name__}: {error}", None
    return prepared, time.perf_counter() - start


def _answer(
    row: Row, prepared: Prepared | PreparedReference | str, case: _Case, correspondence: Correspondence
) -> _Answer:
    if row.method is None:
        if isinstance(prepared, str):
            raise _Unprepared(prepared)
        assert not isinstance(prepared, Prepared)
        start = time.perf_counter()
        frames = prepared(case.problem.target_examples, case.truth)
        found, fitted_at, answered_at = Found(case.known.source_examples), start, time.perf_counter()
        result = RetargetResult(frames, (SolveInfo(),) * len(frames))
        disturbed = None if case.noise is None else frames[: len(case.noise)]
    else:
        found = _found(correspondence, case.known)
        problem = replace(case.problem, source_examples=found.examples)
        if reason := row.method.unsupported(problem):  # which says more than how the set-up failed
            raise _Refused(reason)
        if isinstance(prepared, str):
            raise _Unprepared(prepared)
        assert isinstance(prepared, Prepared)
        start = time.perf_counter()
        fitted = prepared.fit(problem.examples, problem.source_animation)
        fitted_at = time.perf_counter()
        result = fitted(case.source)
        answered_at = time.perf_counter()
        disturbed = None if case.noise is None else fitted(case.source[: len(case.noise)] + case.noise).frames
    seconds = (answered_at - fitted_at) / max(len(case.source), 1)
    return _Answer(_checked(result, case), disturbed, found, fitted_at - start, seconds)


def _found(correspondence: Correspondence, known: Known) -> Found:
    try:
        return correspondence(known)
    except InvalidInput as error:
        raise _Refused(f"no source examples: {error}") from error


def _checked(result: RetargetResult, case: _Case) -> RetargetResult:
    if result.frames.shape != case.truth.shape:
        raise InvalidInput(f"frames: expected {case.truth.shape}, the method returned {result.frames.shape}.")
    if len(result.info) != len(case.truth):
        raise InvalidInput(f"info: expected {len(case.truth)} entries, the method returned {len(result.info)}.")
    if not np.isfinite(result.frames).all():
        raise InvalidInput("frames: the method returned NaN or infinite vertices.")
    return result


def _verdict(result: RetargetResult) -> tuple[str, str]:
    if failed := [info.message for info in result.info if info.status is Status.FAILED]:
        return "failed", f"{len(failed)} of {len(result.info)} solves failed: {failed[0] or 'no reason given'}"
    if late := sum(info.status is Status.MAX_ITERATIONS for info in result.info):
        return "not_converged", f"{late} of {len(result.info)} solves stopped at their iteration limit"
    return "ok", ""


def _record(
    task: PairTask,
    cell: Cell,
    case: _Case,
    clean: Pair,
    answer: _Answer | None,
    status: str,
    reason: str | None,
    timings: dict[str, Any],
) -> None:
    usable = answer is not None and status in ("ok", "not_converged")
    frames = answer.result.frames if answer is not None and usable else case.truth
    comparison = Comparison(
        frames,
        case.truth,
        case.performed,
        clean.source_neutral,
        clean.target_neutral,
        clean.faces,
        clean.regions,
        task.study.ordered,
        _disturbed(case, answer),
    )
    measurements = [measurement for metric in task.metrics for measurement in metric(comparison)]
    header = {
        "schema": SCHEMA,
        "cell": cell.id,
        "code": task.code,
        "data": task.dataset.fingerprint,
        "status": status,
        "reason": reason or "",
        "settings": dict(cell.row.settings),
        "prediction": hashlib.sha256(np.ascontiguousarray(frames).tobytes()).hexdigest() if usable else None,
        "solves": [] if answer is None else [_solve(info) for info in answer.result.info],
        "correspondence_solves": [] if answer is None else [_solve(info) for info in answer.found.solves],
        "directions": {measurement.metric: measurement.direction for measurement in measurements},
        "peak_memory_mb": peak_memory_mb(),
        **{key: value if value is None or np.isfinite(value) else None for key, value in timings.items()},
    }
    folder = task.folder / cell.id
    if answer is not None and usable:
        task.study.keep(folder, cell.keep_frames, answer.result.frames)
        if cell.keep_frames:
            shown = list(task.study.figure_frames(len(case.truth)))
            _write_frames(folder / FRAMES, case, clean, answer.result, shown)
    write_record(folder, Record(header, _rows(task, cell, case, measurements, status, not usable)))


def _disturbed(case: _Case, answer: _Answer | None) -> Disturbed | None:
    if case.noise is None or answer is None or answer.disturbed is None:
        return None
    return Disturbed(case.noise, answer.disturbed)


def _solve(info: SolveInfo) -> dict[str, Any]:
    return {
        "status": str(info.status),
        "iterations": info.iterations,
        "energy": list(info.energy),
        "message": info.message,
    }


def _rows(
    task: PairTask, cell: Cell, case: _Case, measurements: Sequence[Measurement], status: str, empty: bool
) -> pa.Table:
    """Tidy rows; the values of a cell without an answer are NaN, so that it shows as such and never as a blank."""
    frames, count = len(case.expressions), len(case.expressions) * len(measurements)
    values = np.concatenate([measurement.values for measurement in measurements])
    varying = {
        "expression": list(case.expressions) * len(measurements),
        "metric": [measurement.metric for measurement in measurements for _ in range(frames)],
        "region": [measurement.region for measurement in measurements for _ in range(frames)],
        "value": np.full(count, np.nan) if empty else values,
        "unit": [measurement.unit for measurement in measurements for _ in range(frames)],
    }
    constant = asdict(task.dataset.conditions) | {
        "method": cell.row.name,
        "source": cell.source,
        "target": cell.target,
        "n_examples": cell.n_examples,
        "draw": cell.draw,
        "correspondence": cell.correspondence,
        "status": status,
    }
    columns = varying | {name: [value] * count for name, value in constant.items()}
    return pa.table({name: columns[name] for name in METRIC_COLUMNS})


def _write_frames(path: Path, case: _Case, clean: Pair, result: RetargetResult, shown: list[int]) -> None:
    """Frames for the report's figures, so that they rebuild without running a method; the source's are as scanned."""
    arrays: dict[str, Any] = {
        "faces": clean.faces.astype(np.int32),
        "source_neutral": case.problem.source_neutral.astype(np.float32),
        "target_neutral": clean.target_neutral.astype(np.float32),
        "source": case.source[shown].astype(np.float32),
        "truth": case.truth[shown].astype(np.float32),
        "retargeted": result.frames[shown].astype(np.float32),
        "expressions": np.array(case.expressions)[shown],
        "region_head": np.asarray(clean.regions.vertices.get("head", np.arange(len(clean.source_neutral)))),
    } | {f"part_{name}": part[shown].astype(np.float32) for name, part in result.parts.items()}

    def save(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)

    write_whole(path, save)
