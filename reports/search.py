"""Where results lie: in the folders that a command was given, or below them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from retarget.check import InvalidInput

DEPTH = 2  # levels below a folder at which results are looked for: results/<study>/<condition>


def find_results(folders: Sequence[Path], holds: Callable[[Path], bool]) -> list[Path]:
    """Each folder that `holds` results once; one that holds none itself stands for those inside it.

    Raises InvalidInput for no folders at all, and for one without any results.
    """
    if not folders:
        raise InvalidInput("report: expected at least one results folder, got none; run a study first.")
    found: dict[Path, None] = {}
    for folder in map(Path, folders):
        inside = _inside(folder, holds, DEPTH)
        if not inside:
            raise InvalidInput(
                f"{folder}: expected a results folder with a study.json, found none there or {DEPTH} levels below. "
                "Name the folder that a finished run printed, for example results/quantitative."
            )
        found |= dict.fromkeys(path.resolve() for path in inside)
    return list(found)


def _inside(folder: Path, holds: Callable[[Path], bool], depth: int) -> list[Path]:
    if holds(folder):
        return [folder]
    if not depth or not folder.is_dir():
        return []
    below = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    return [path for inner in below for path in _inside(inner, holds, depth - 1)]
