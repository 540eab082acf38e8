"""Regions as a JSON file: a line per name, sets as runs such as ``"0-6 9 12-20"``, so that changes can be reviewed."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from retarget.check import InvalidInput
from retarget.geometry.edge_loops import is_edge_cycle
from retarget.io.files import write_whole
from retarget.types import AffinePoint, IntArray, Regions

PARTS = ("vertices", "loops", "triangles", "patches", "landmarks", "points")


def read_regions(path: Path | str, vertex_count: int, faces: IntArray) -> Regions:
    """Regions of a file for a mesh of this many vertices and these faces (f, 3), as `check_regions` accepts them.

    Parts that a file leaves out are empty. Raises InvalidInput.
    """
    path = Path(path)
    if not path.is_file():
        raise InvalidInput(f"{path}: expected a regions file, found none; check the path.")
    regions = decode(path.read_text(), str(path))
    check_regions(str(path), regions, vertex_count, faces)
    return regions


def write_regions(path: Path | str, regions: Regions) -> None:
    """Write the file whole or not at all."""
    write_whole(Path(path), lambda temporary: temporary.write_text(encode(regions)))


def decode(text: str, name: str = "regions") -> Regions:
    """Regions from JSON, see `encode`; raises InvalidInput that names the entry which cannot be read."""
    try:
        stored: Any = json.loads(text)
    except json.JSONDecodeError as error:
        raise InvalidInput(f"{name}: expected JSON, but line {error.lineno} is none ({error.msg}).") from error
    if not isinstance(stored, dict) or not all(isinstance(stored.get(part, {}), dict) for part in PARTS):
        raise InvalidInput(f"{name}: expected an object with the parts {', '.join(PARTS)}, each by name.")
    if unknown := sorted(set(stored) - {*PARTS, "mirror"}):
        raise InvalidInput(f"{name}: unknown parts {', '.join(unknown)}, expected {', '.join(PARTS)} and mirror.")
    entry = ""

    def named(part: str) -> Iterable[tuple[str, Any]]:
        nonlocal entry
        for key, value in stored.get(part, {}).items():
            entry = f"{part}[{key!r}]"
            yield key, value

    try:
        regions = Regions(
            vertices={key: _from_runs(runs) for key, runs in named("vertices")},
            loops={key: np.array(loop, dtype=np.int64).reshape(-1) for key, loop in named("loops")},
            triangles={key: _from_runs(runs) for key, runs in named("triangles")},
            patches={key: np.array(patch, dtype=np.int64).reshape(-1, 3) for key, patch in named("patches")},
            landmarks={key: int(vertex) for key, vertex in named("landmarks")},
            points={
                key: AffinePoint(
                    np.array(point["indices"], dtype=np.int64), np.array(point["weights"], dtype=np.float64)
                )
                for key, point in named("points")
            },
        )
        entry = "mirror"
        mirror = stored.get("mirror")
        return regions if mirror is None else replace(regions, mirror=np.array(mirror, dtype=np.int64))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InvalidInput(f"{name}: {entry} cannot be read ({error}); docs/regions.md shows the format.") from error


def encode(regions: Regions) -> str:
    """JSON text; ``mirror`` is null where it is unknown."""
    parts: dict[str, dict[str, object]] = {
        "vertices": {name: _to_runs(indices) for name, indices in regions.vertices.items()},
        "loops": {name: loop.tolist() for name, loop in regions.loops.items()},
        "triangles": {name: _to_runs(indices) for name, indices in regions.triangles.items()},
        "patches": {name: patch.ravel().tolist() for name, patch in regions.patches.items()},
        "landmarks": dict(regions.landmarks),
        "points": {
            name: {"indices": point.indices.tolist(), "weights": point.weights.tolist()}
            for name, point in regions.points.items()
        },
    }
    blocks = [f'"{part}": {{\n{_lines(entries)}\n}}' for part, entries in parts.items()]
    mirror = None if regions.mirror is None else regions.mirror.tolist()
    return "{\n" + ",\n".join([*blocks, f'"mirror": {_compact(mirror)}']) + "\n}\n"


def check_regions(name: str, regions: Regions, vertex_count: int, faces: IntArray) -> None:
    """Raises InvalidInput for what does not fit a mesh of this many vertices and these faces (f, 3).

    Indices out of range; sets that are not ascending; loops that are no closed chain of edges or meet themselves;
    patches with a corner twice; points whose weights do not sum to one; a mirror that is no involution.
    """

    def within(entry: str, indices: IntArray, count: int, what: str) -> None:
        if len(indices) and (indices.min() < 0 or indices.max() >= count):
            raise InvalidInput(
                f"{name}: {entry} names {what} {indices.min()} to {indices.max()}, expected 0 to {count - 1}; "
                "it belongs to another mesh."
            )

    for part, sets, count, what in (
        ("vertices", regions.vertices, vertex_count, "vertices"),
        ("triangles", regions.triangles, len(faces), "triangles"),
    ):
        for key, members in sets.items():
            within(f"{part}[{key!r}]", members, count, what)
            if (np.diff(members) <= 0).any():
                raise InvalidInput(f"{name}: {part}[{key!r}] is not ascending, expected each number once, in order.")
    for key, loop in regions.loops.items():
        within(f"loops[{key!r}]", loop, vertex_count, "vertices")
        if not is_edge_cycle(loop, faces, vertex_count):
            raise InvalidInput(
                f"{name}: loops[{key!r}] is no closed chain of edges, expected each vertex once and an edge from each "
                "to the next and from the last to the first; complete it."
            )
    for key, patch in regions.patches.items():
        within(f"patches[{key!r}]", patch, vertex_count, "vertices")
        if (np.diff(np.sort(patch, axis=1), axis=1) == 0).any():
            raise InvalidInput(f"{name}: patches[{key!r}] has a triangle with a corner twice; remove it.")
    within("landmarks", np.array(list(regions.landmarks.values()), dtype=np.int64), vertex_count, "vertices")
    for key, point in regions.points.items():
        within(f"points[{key!r}]", point.indices, vertex_count, "vertices")
        if point.indices.shape != point.weights.shape or not abs(point.weights.sum() - 1) < 1e-9:
            raise InvalidInput(
                f"{name}: points[{key!r}] has {len(point.indices)} vertices and {len(point.weights)} weights with the "
                f"sum {point.weights.sum():g}, expected as many of both and the sum 1."
            )
    if (mirror := regions.mirror) is not None:
        within("mirror", mirror, vertex_count, "vertices")
        if len(mirror) != vertex_count or (mirror[mirror] != np.arange(vertex_count)).any():
            raise InvalidInput(f"{name}: mirror is no pairing of all {vertex_count} vertices; set it to null.")


def _lines(entries: dict[str, object]) -> str:
    return ",\n".join(f"{_compact(name)}: {_compact(entry)}" for name, entry in entries.items())


def _compact(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))


def _to_runs(indices: Iterable[int]) -> str:
    """Ascending indices as ``"first-last"`` and single numbers."""
    runs = []
    for _, run in groupby(enumerate(int(i) for i in indices), key=lambda pair: pair[1] - pair[0]):
        members = [i for _, i in run]
        runs.append(f"{members[0]}-{members[-1]}" if len(members) > 1 else str(members[0]))
    return " ".join(runs)


def _from_runs(runs: str) -> IntArray:
    ends = [[int(i) for i in run.split("-")] for run in runs.split()]
    return np.array([i for run in ends for i in range(run[0], run[-1] + 1)], dtype=np.int64)
