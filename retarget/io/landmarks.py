"""Landmarks that a person picked on a mesh: ``{"unit": "cm", "landmarks": {"nasion": 978, ...}}``, counted from 0."""

from __future__ import annotations

import json
from pathlib import Path

from retarget.anatomy.landmarks import UNITS
from retarget.check import InvalidInput


def read_landmarks(path: Path | str) -> tuple[float, dict[str, int]]:
    """The mesh's unit in mm (1 where the file names none) and the vertex of each name. Raises InvalidInput."""
    path = Path(path)
    if not path.is_file():
        raise InvalidInput(f"{path}: expected a landmarks file, found none; check the path.")
    try:
        stored = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise InvalidInput(f"{path}: expected JSON, but line {error.lineno} is none ({error.msg}).") from error
    marks = stored.get("landmarks") if isinstance(stored, dict) else None
    if not isinstance(marks, dict) or not all(type(vertex) is int for vertex in marks.values()):
        raise InvalidInput(
            f'{path}: expected {{"unit": "cm", "landmarks": {{"nasion": 978, ...}}}} with a vertex for each name; '
            "docs/own_topology.md shows an example."
        )
    unit = stored.get("unit", "mm")
    units = {"mm": 1.0, **UNITS}
    if unit not in units:
        raise InvalidInput(f"{path}: unit {unit!r} unknown, expected one of {', '.join(units)}.")
    return units[unit], marks
