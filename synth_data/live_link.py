"""Recordings of the Live Link Face app (iPhone, ARKit), as it writes them to CSV.

A row is a timecode, a count, the 52 face units and nine rotations of head and eyes, which may be absent. Columns are
found by name: tools differ in their order, and the app itself puts right before left in some pairs. A row without
tracking is ``timecode,0``. Timecodes are ``HH:MM:SS:FF.fff``.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from retarget.check import InvalidInput
from retarget.suggest import nearest
from retarget.types import FloatArray
from synth_data.arkit import NAMES
from synth_data.recording import ROTATIONS, Recording

TOLERATED = (-0.5, 2.0)  # what the app writes lies near [0, 1] and is clipped; beyond this it is another unit
FRAME_RATES = (24, 25, 30, 60)  # in which a timecode may count its frames; the app counts in 60ths at any speed
_DAY = 86400.0  # s
_TIMECODE = re.compile(r"(\d{1,2}):(\d{1,2}):(\d{1,2})[:;](\d{1,2}(?:\.\d*)?)")
_COLUMNS = (*NAMES, *ROTATIONS)
_EXPORT = "export the take from Live Link Face again"


@dataclass(frozen=True)
class _Row:
    line: int
    second: float  # of the day, whole
    frame: float  # within the second
    values: tuple[float, ...] | None  # in the order of `_COLUMNS`, 0 if absent; None where tracking was lost


def read_live_link(path: Path | str) -> Recording:
    """The recording of a CSV. Lost rows are filled linearly in time, values outside [0, 1] are clipped.

    Raises InvalidInput that names the file and the line where columns are missing, unknown or named twice, the
    delimiter is no comma, a row is ragged, a value is no finite number or lies far outside [0, 1], none is positive but
    some are negative, timecodes do not increase, or no two rows were tracked.
    """
    path = Path(path)
    if not is_file(path):
        raise InvalidInput(f"{path}: expected a CSV file of Live Link Face, found none; check the path.")
    rows = tuple(_rows(path))
    tracked = np.array([row.values is not None for row in rows], dtype=bool)
    if not rows:
        raise InvalidInput(f"{path}: expected rows of weights below the header, found none; {_EXPORT}.")
    if tracked.sum() < 2:
        raise InvalidInput(
            f"{path}: expected at least two rows with a tracked face, got {tracked.sum()} of {len(rows)} (a row "
            "'timecode,0' has lost it); record again with the face in view."
        )
    times = _times(path, rows)
    values = np.array([row.values for row in rows if row.values is not None])
    weights = values[:, : len(NAMES)]
    extent = float(weights.min()), float(weights.max())
    low, high = TOLERATED
    if not low <= extent[0] <= extent[1] <= high:
        worst, column = np.unravel_index(np.argmax(np.abs(weights - 0.5)), weights.shape)
        raise InvalidInput(
            f"{path}, line {[row.line for row in rows if row.values][worst]}: {_app(NAMES[column])} is "
            f"{weights[worst, column]:g}, expected about 0 to 1; divide by 100 if these are percent."
        )
    if extent[0] < 0 >= extent[1]:
        raise InvalidInput(
            f"{path}: expected weights from 0 to 1, but no weight is above 0 (they reach from {extent[0]:.3g} to "
            f"{extent[1]:.3g}), so that clipping would leave no motion; exchange the sign if it was lost, or {_EXPORT}."
        )
    clipped = np.zeros(len(rows), dtype=bool)
    clipped[tracked] = ((weights < 0) | (weights > 1)).any(axis=1)
    values[:, : len(NAMES)] = weights.clip(0, 1)
    filled = np.stack([np.interp(times, times[tracked], column) for column in values.T], axis=1)
    weights, rotations = filled[:, : len(NAMES)], filled[:, len(NAMES) :]
    return Recording(path.stem, times, weights, rotations, ~tracked, clipped, extent=extent)


def _rows(path: Path) -> Iterator[_Row]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file)
            order, width = _header(path, next(lines, []))
            for row in lines:
                if row:
                    yield _row(path, lines.line_num, row, order, width)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(f"{path}: expected a CSV file of text in UTF-8, but {error}; {_EXPORT}.") from error


def _header(path: Path, header: Sequence[str]) -> tuple[list[int | None], int]:
    """Where the columns of `_COLUMNS` are, and how many there are in the file. Rotations may be absent: None."""
    if not header:
        raise InvalidInput(f"{path}: expected a header in line 1, got an empty one; {_EXPORT}.")
    if len(header) == 1 and (other := next((mark for mark in ";\t|" if mark in header[0]), None)):
        raise InvalidInput(
            f"{path}, line 1: expected columns separated by commas, got {other!r}; save the table as CSV with commas "
            "between columns and points in decimals."
        )
    names = [name.strip() for name in header]
    names = [name[:1].lower() + name[1:] for name in names]
    if [name.lower() for name in names[:2]] != ["timecode", "blendshapecount"]:
        raise InvalidInput(
            f"{path}, line 1: expected a header that begins with Timecode,BlendShapeCount, got "
            f"'{','.join(header[:2])[:60]}'; {_EXPORT}."
        )
    found = names[2:]
    for what, wrong in (
        ("unknown", [name for name in found if name not in _COLUMNS]),
        ("named twice:", sorted({name for name in found if found.count(name) > 1})),
        ("missing:", [name for name in NAMES if name not in found]),
    ):
        if wrong:
            listed = ", ".join(map(_app, wrong[:5])) + ", ..." * (len(wrong) > 5)
            guess = nearest(_app(wrong[0]), map(_app, _COLUMNS)) if what == "unknown" else ""
            raise InvalidInput(
                f"{path}, line 1: expected the {len(NAMES)} face units of ARKit and up to {len(ROTATIONS)} rotations, "
                f"but {len(wrong)} columns are {what} {listed}.{guess} Mend the header, or {_EXPORT}."
            )
    return [2 + found.index(name) if name in found else None for name in _COLUMNS], len(names)


def _row(path: Path, line: int, row: Sequence[str], order: Sequence[int | None], width: int) -> _Row:
    where = f"{path}, line {line}"
    match = _TIMECODE.fullmatch(row[0].strip())
    hours, minutes, seconds, frame = map(float, match.groups()) if match else (np.inf,) * 4
    if not (hours < 24 and max(minutes, seconds, frame) < 60):
        raise InvalidInput(
            f"{where}: expected a timecode HH:MM:SS:FF.fff, got '{row[0][:40]}'; mend or delete the line."
        )
    second = 3600 * hours + 60 * minutes + seconds
    if len(row) > 1 and row[1].strip() == "0" and not any(cell.strip(" 0.") for cell in row[2:]):
        return _Row(line, second, frame, None)
    if len(row) != width:
        raise InvalidInput(
            f"{where}: expected {width} values as in the header, or 'timecode,0' where tracking was lost, got "
            f"{len(row)}; the file may have been cut off: delete the line."
        )
    try:
        values = tuple(0.0 if i is None else float(row[i]) for i in order)
    except ValueError:
        values = (np.nan,)
    if not np.isfinite(values).all():
        read = ((name, row[i]) for name, i in zip(_COLUMNS, order, strict=True) if i is not None)
        name, text = next((_app(name), text) for name, text in read if not _finite(text))
        raise InvalidInput(f"{where}: expected a number for {name}, got '{text[:40]}'; mend or delete the line.")
    return _Row(line, second, frame, values)


def _times(path: Path, rows: Sequence[_Row]) -> FloatArray:
    """(t,) s from the first row. A take may pass midnight once."""
    seconds = np.array([row.second for row in rows])
    frames = np.array([row.frame for row in rows])
    midnight = np.flatnonzero(np.diff(seconds) < -_DAY / 2)[:1]
    seconds += _DAY * (np.arange(len(rows)) > midnight) if len(midnight) else 0.0
    times = seconds + frames / _rate(seconds, frames)
    backwards = np.flatnonzero(np.diff(times) <= 0)
    if len(backwards):
        raise InvalidInput(
            f"{path}, line {rows[backwards[0] + 1].line}: expected a timecode later than that of the row before, got "
            "an earlier or the same one; two takes in one file? Split them, or sort the rows."
        )
    return times - times[0]


def _rate(seconds: FloatArray, frames: FloatArray) -> int:
    """In which of `FRAME_RATES` frames are counted: one that no count reaches.

    Where the last count of a second is followed by the first of the next, they are as far apart as the others. A take
    within one second that counts to less than 30 has 30 frames per second: counted in 60ths, every second one is there.
    """
    rates = [rate for rate in FRAME_RATES if frames.max() < rate]
    later, step = np.diff(seconds), np.diff(frames)
    if len(rates) == 1 or not (later == 0).any():
        return FRAME_RATES[-1]
    spacing = float(np.median(step[later == 0]))
    counted = spacing - step[later == 1]  # in a second, where no row was dropped at its end
    counted = counted[counted > FRAME_RATES[0] - 0.5]
    if len(counted):
        return min(rates, key=lambda rate: abs(rate - float(np.median(counted))))
    return 30 if spacing < 1.5 else 60


def is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long, or that no file can have
        return False


def _finite(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _app(name: str) -> str:
    """As the app writes it."""
    return name[:1].upper() + name[1:] or "(no name)"
