"""Results folders, read back: everything a report says comes from study.json, metrics.parquet and cells.parquet."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from reports.cells import FINISHED
from reports.checks import check_facts, check_tables
from reports.search import find_results
from reports.summary import summarise
from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray

SCHEMA = 1
SANITY = ("additive",)  # kinds of truth on which a method is exact by construction: no statement is made of them
_IRRELEVANT = ("paths", "backend", "report", "hydra", "conditions")  # parts of a configuration that decide no number


@dataclass(frozen=True)
class MethodFacts:
    """One row of a study's table as its author describes it."""

    name: str
    label: str
    description: str
    kind: str  # "method", "control" or "reference"
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class FigureCell:
    """A cell whose frames were kept: (source, target, n_examples, draw) of one method."""

    method: str
    source: str
    target: str
    n_examples: int
    draw: int
    path: Path

    @cached_property
    def frames(self) -> Frames:
        with np.load(self.path) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return Frames(
            **{name: arrays[name] for name in ("faces", "source_neutral", "target_neutral", "source", "truth")},
            retargeted=arrays["retargeted"],
            head=arrays["region_head"],
            expressions=tuple(str(name) for name in arrays["expressions"]),
            parts={name.removeprefix("part_"): arrays[name] for name in arrays if name.startswith("part_")},
        )


@dataclass(frozen=True)
class Frames:
    """What one cell's pictures need, in mm."""

    faces: IntArray  # (f, 3)
    source_neutral: NDArray[np.floating[Any]]  # (n, 3)
    target_neutral: NDArray[np.floating[Any]]  # (n, 3)
    source: NDArray[np.floating[Any]]  # (t, n, 3)
    truth: NDArray[np.floating[Any]]  # (t, n, 3)
    retargeted: NDArray[np.floating[Any]]  # (t, n, 3)
    head: IntArray  # (m,) vertices that errors are measured on
    expressions: tuple[str, ...]
    parts: Mapping[str, NDArray[np.floating[Any]]] = field(default_factory=dict)  # (t, n, 3) each

    def error(self, frame: int, of: NDArray[np.floating[Any]] | None = None) -> FloatArray:
        """(n,) vertex L2 in mm on the head, NaN elsewhere; of the result, or of other frames (t, n, 3) mm."""
        shown = self.retargeted if of is None else of
        return self.distance(shown[frame], self.truth[frame])

    def distance(self, one: NDArray[np.floating[Any]], other: NDArray[np.floating[Any]]) -> FloatArray:
        """(n,) distance in mm of two meshes (n, 3) mm on the head, NaN elsewhere."""
        distance = np.full(len(self.target_neutral), np.nan)
        distance[self.head] = np.linalg.norm(one[self.head].astype(np.float64) - other[self.head], axis=1)
        return distance


@dataclass(frozen=True)
class StudyResults:
    """One results folder: one study under one set of conditions."""

    folder: Path
    facts: Mapping[str, Any]  # study.json
    metrics: pd.DataFrame
    summary: pd.DataFrame  # of `summary.summarise`
    cells: pd.DataFrame
    differs: str = ""  # what sets it apart from the other folders of one report, e.g. "dataset.noise_mm=0.3"

    @cached_property
    def methods(self) -> tuple[MethodFacts, ...]:
        return tuple(
            MethodFacts(m["name"], m["label"], m["description"], m["kind"], m["settings"])
            for m in self.facts["methods"]
        )

    def label(self, method: str) -> str:
        """The name to print for a method."""
        return next((m.label for m in self.methods if m.name == method), method)

    def kind(self, method: str) -> str:
        """The kind of a method; "method" for one that is not in the table."""
        return next((m.kind for m in self.methods if m.name == method), "method")

    @property
    def sanity(self) -> bool:
        """Whether its truth is a check of the methods that are exact on it, and no evidence."""
        return self.facts["dataset"]["truth"] in SANITY

    @property
    def unit(self) -> str:
        """The unit of the primary metric."""
        return self.unit_of(self.facts["primary_metric"])

    def unit_of(self, metric: str) -> str:
        return str(self.metrics.loc[self.metrics["metric"] == metric, "unit"].iloc[0])

    def measured(self, listed: Sequence[Sequence[str]]) -> list[tuple[str, str]]:
        """Those of some measures (metric, region) that the study took."""
        taken = set(zip(self.summary["metric"], self.summary["region"], strict=True))
        return [(metric, region) for metric, region in listed if (metric, region) in taken]

    @cached_property
    def tested(self) -> tuple[str, ...]:
        """All rows but the references, which enter no test."""
        return tuple(m.name for m in self.methods if m.kind != "reference")

    @property
    def primary(self) -> pd.DataFrame:
        """Summary rows of the primary metric and region."""
        return self.at(self.facts["primary_metric"], self.facts["primary_region"])

    def at(self, metric: str, region: str) -> pd.DataFrame:
        s = self.summary
        return s[(s["metric"] == metric) & (s["region"] == region)]

    @cached_property
    def figure_cells(self) -> tuple[FigureCell, ...]:
        """The cells with stored frames, in the order of the table."""
        return tuple(self._figure_cells())

    def _figure_cells(self) -> Iterator[FigureCell]:
        for row in self.cells[self.cells["status"].isin(FINISHED)].to_dict("records"):
            path = self.folder / str(row["cell"]) / "frames.npz"
            if path.exists():
                yield FigureCell(
                    row["method"], row["source"], row["target"], int(row["n_examples"]), int(row["draw"]), path
                )


def load(folders: Sequence[Path]) -> tuple[StudyResults, ...]:
    """Read results folders; one without a study.json stands for the results folders inside it.

    A study with several correspondences of examples becomes one for each. Several folders are told apart by what their
    configurations set differently; they stand in the order in which their study lists its conditions, else in that of
    their start, whichever is named first, and a truth of `SANITY` last. Raises InvalidInput for a folder that holds no
    finished study, or one of another schema, and for tables that are not whole (`reports.checks`).
    """
    found = find_results(folders, lambda folder: (folder / "study.json").exists())
    whole = sorted((_load(path) for path in found), key=_place)
    studies = [part for study in whole for part in _by_correspondence(study)]
    return tuple(replace(s, differs=differs) for s, differs in zip(studies, _differences(studies), strict=True))


def _place(study: StudyResults) -> tuple[bool, int, str, str]:
    """Sorts the conditions of a study: the same folders give the same order, however they were named."""
    listed = study.facts["config"].get("conditions")
    names = listed if isinstance(listed, list) else []
    place = names.index(study.folder.name) if study.folder.name in names else len(names)
    return study.sanity, place, study.facts["provenance"]["started"], str(study.folder)


def _by_correspondence(study: StudyResults) -> Iterator[StudyResults]:
    for name in study.cells["correspondence"].unique():
        metrics, summary, cells = (
            table[table["correspondence"] == name].reset_index(drop=True)
            for table in (study.metrics, study.summary, study.cells)
        )
        yield replace(study, metrics=metrics, summary=summary, cells=cells)


def _load(folder: Path) -> StudyResults:
    path = folder / "study.json"
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InvalidInput(
            f"{path}: expected JSON, {error}. Run the study again; finished cells are reused."
        ) from error
    schema = facts.get("schema") if isinstance(facts, dict) else None
    if schema != SCHEMA:
        raise InvalidInput(
            f"{path}: these results have schema {schema}, this version reads schema {SCHEMA}. "
            "Nothing was changed. Read them with the version that wrote them, or run the study again elsewhere."
        )
    check_facts(path, facts)
    metrics, cells = _table(folder / "metrics.parquet"), _table(folder / "cells.parquet")
    check_tables(folder, facts, metrics, cells)
    return StudyResults(folder, facts, metrics, _summary(facts, metrics), cells)


def _summary(facts: Mapping[str, Any], metrics: pd.DataFrame) -> pd.DataFrame:
    """The table of summary.csv, made anew: what a report says has one source."""
    untested = {method["name"] for method in facts["methods"] if method["kind"] == "reference"}
    return summarise(
        metrics,
        facts["reference"],
        [name for name in facts["primary_family"] if name not in untested],
        facts["primary_metric"],
        facts["primary_region"],
        facts["provenance"]["seed"],
    )


def _table(path: Path) -> pd.DataFrame:
    try:
        return pd.read_parquet(path)
    except FileNotFoundError as error:
        raise InvalidInput(f"{path}: this file is missing, so the study did not finish; start it again.") from error
    except (pa.ArrowException, ValueError) as error:
        raise InvalidInput(
            f"{path}: cannot be read ({error}); run the study again, finished cells are reused."
        ) from error


def _differences(studies: Sequence[StudyResults]) -> list[str]:
    if len(studies) == 1:
        return [""]
    flat = [
        dict(_flatten({k: v for k, v in s.facts["config"].items() if k not in _IRRELEVANT}))
        | {"correspondence": str(s.cells["correspondence"].iloc[0])}
        for s in studies
    ]
    keys = sorted(set().union(*flat))
    differing = [key for key in keys if any(str(f.get(key)) != str(flat[0].get(key)) for f in flat)]
    labels = [", ".join(f"{key}={f[key]}" for key in differing if key in f) for f in flat]
    if len(set(labels)) < len(labels):
        return [
            f"{s.folder.name}: {label}" if label else s.folder.name for s, label in zip(studies, labels, strict=True)
        ]
    return labels


def _flatten(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in config.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
