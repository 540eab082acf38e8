"""Results folders of all kinds, sorted into what one document is made of."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from reports.load import StudyResults, load
from reports.runtime_sheet import runtime_blocks
from reports.search import find_results
from reports.sheet import Table, read_sheet
from retarget.check import InvalidInput

KINDS = {  # of studies that are no comparison: files that tell them, and columns of summary.csv
    "runtime": (("frames.csv", "method.csv"), ("surface", "expressions_per_s")),
    "collision": (("cases.csv", "propagation.csv"), ("pair", "crossing", "resolved")),
    "artistic": ((), ("edit", "contour_after_mm")),
}
_LATER = ("ablation", "embedding", "sensitivity", "temporal")  # in the order of the paper, after the comparisons


@dataclass(frozen=True)
class Sheet:
    """Pages of a study that is no comparison. folder: where its pictures lie, None without any."""

    study: str
    title: str
    description: str
    blocks: Sequence[Mapping[str, Any] | Table]
    folder: Path | None = None


@dataclass(frozen=True)
class Gathered:
    """What a document is made of, in its order."""

    folders: tuple[Path, ...]
    groups: tuple[tuple[StudyResults, ...], ...]  # studies of one name stand for conditions of one another
    sheets: tuple[Sheet, ...]
    tables: Mapping[str, Mapping[str, pd.DataFrame]] = field(default_factory=dict)  # kind -> study -> summary.csv
    left_out: tuple[str, ...] = ()  # what cannot be shown, in words


def gather(folders: Sequence[Path]) -> Gathered:
    """Read results folders; one that holds no results itself stands for those inside it.

    Raises InvalidInput for a folder without any, and for results that are incomplete or of another schema.
    """
    found = results_folders(folders)
    by_name: dict[str, list[Path]] = {}
    for folder in found:
        if (folder / "study.json").exists() and not (folder / "trials.csv").exists():
            by_name.setdefault(_study_name(folder), []).append(folder)
    names = sorted(by_name, key=lambda name: _LATER.index(name) if name in _LATER else -1)
    sheets: list[Sheet] = []
    tables: dict[str, dict[str, pd.DataFrame]] = {}
    left_out: list[str] = []
    for folder in found:
        shown = [_read(path) for path in sorted(folder.glob("*.sheet"))]
        kind = _kind(folder)
        if kind:
            tables.setdefault(kind, {})[folder.name] = _summary(folder, kind)
        if kind == "runtime":
            title, said = "Expressions per second", "The simulation and the whole method, one expression at a time."
            shown.append(Sheet(folder.name, title, said, runtime_blocks(tables[kind][folder.name])))
        elif not shown and not (folder / "study.json").exists():
            left_out.append(f"{folder.name}: it keeps no pages of its own; run the study again to have them here.")
        sheets += shown
    return Gathered(tuple(found), tuple(load(by_name[name]) for name in names), tuple(sheets), tables, tuple(left_out))


def results_folders(folders: Sequence[Path]) -> list[Path]:
    """Results of all kinds in these folders or below them, as `reports.search.find_results` finds them."""
    return find_results(folders, _holds_results)


def _holds_results(folder: Path) -> bool:
    return (folder / "study.json").exists() or bool(_kind(folder)) or any(folder.glob("*.sheet"))


def _kind(folder: Path) -> str:
    """The kind of a study that is no comparison, by its files; empty for all others."""
    path = folder / "summary.csv"
    if (folder / "study.json").exists() or not path.exists():
        return ""
    columns = _read_csv(path).columns
    return next(
        (
            kind
            for kind, (files, needed) in KINDS.items()
            if set(needed) <= set(columns) and all((folder / name).exists() for name in files)
        ),
        "",
    )


def _read_csv(path: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(path)
    except ValueError as error:
        raise InvalidInput(f"{path}: cannot be read as a table ({error}); run the study again.") from error


def _summary(folder: Path, kind: str) -> pd.DataFrame:
    table = _read_csv(folder / "summary.csv")
    if table.empty:
        raise InvalidInput(
            f"{folder / 'summary.csv'}: this table of a study of the kind {kind} is empty; run it again."
        )
    return table


def _read(folder: Path) -> Sheet:
    content = read_sheet(folder)
    return Sheet(folder.parent.name, content["title"], content["description"], content["blocks"], folder)


def _study_name(folder: Path) -> str:
    """The name alone; what else is wrong with the file `load` says."""
    try:
        facts = json.loads((folder / "study.json").read_text(encoding="utf-8"))
    except ValueError:
        return folder.name
    return str(facts.get("study", folder.name)) if isinstance(facts, dict) else folder.name
