"""Named regions, loops and landmarks of the MakeHuman head: data in ``regions.json``, pictures in docs/regions.md."""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import cache
from importlib import resources
from itertools import groupby

import numpy as np

from retarget.types import AffinePoint, IntArray, Regions

FILE = "regions.json"


@cache
def load_regions() -> Regions:
    """Regions of the base head (4,328 vertices); docs/regions.md lists and shows every name.

    The character's left is +x. Names that come in pairs end in ``_left`` and ``_right``; the right one is the mirror
    image of the left one, in the same order.
    """
    return decode((resources.files(__package__) / FILE).read_text())


def decode(text: str) -> Regions:
    """Regions from the text of ``regions.json``, see `encode`."""
    stored = json.loads(text)
    return Regions(
        vertices={name: _from_runs(runs) for name, runs in stored["vertices"].items()},
        loops={name: np.array(loop, dtype=np.int64) for name, loop in stored["loops"].items()},
        triangles={name: _from_runs(runs) for name, runs in stored["triangles"].items()},
        patches={name: np.array(patch, dtype=np.int64).reshape(-1, 3) for name, patch in stored["patches"].items()},
        landmarks=stored["landmarks"],
        points={
            name: AffinePoint(np.array(point["indices"], dtype=np.int64), np.array(point["weights"]))
            for name, point in stored["points"].items()
        },
        mirror=np.array(stored["mirror"], dtype=np.int64),
    )


def encode(regions: Regions) -> str:
    """JSON with one line per name; sets are runs such as ``"0-6 9 12-20"``, so that a change can be reviewed."""
    assert regions.mirror is not None
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
    return "{\n" + ",\n".join([*blocks, f'"mirror": {_compact(regions.mirror.tolist())}']) + "\n}\n"


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
