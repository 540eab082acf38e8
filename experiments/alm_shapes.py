"""Error of ALM against the number of shapes: Figs 14 and 15 of Chandran et al. 2022, and its own examples back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from experiments.alm_study import AlmStudy, Case, cases, write
from experiments.backend import limited_threads
from experiments.catalogue import MethodMaker
from experiments.progress import progress
from reports.curves_sheet import Panel
from retarget.check import InvalidInput, check_whole
from synth_data.dataset import Dataset

UNITS = {"millimetres": 1.0, "centimetres": 10.0, "metres": 1000.0}
METHODS = ("alm", "alm_paper", "lbs")
LOCAL, GLOBAL = "patches", "global blendshapes"


@dataclass(frozen=True, kw_only=True)
class ShapesStudy(AlmStudy):
    """``conf/study/alm_shapes.yaml``. counts: of shapes, the neutral not counted."""

    counts: list[int]

    def check(self) -> None:
        if not isinstance(self.counts, list) or sorted(set(self.counts)) != self.counts:
            raise InvalidInput(f"study.counts: expected different counts in ascending order, got {self.counts!r}.")
        for count in self.counts:
            check_whole("study.counts", count, 1)
        if self.counts[-1] > self.shapes:
            raise InvalidInput(f"study.counts: expected at most study.shapes = {self.shapes}, got {self.counts[-1]}.")


def grow(
    study: ShapesStudy, makers: Sequence[MethodMaker], dataset: Dataset, threads: int, folder: Path, console: Console
) -> None:
    """Run the study and write ``records.csv``, ``summary.csv`` and ``alm_shapes.pdf``.

    Raises InvalidInput unless the methods are those of `METHODS`; each with the settings that it was given.
    """
    chosen = {maker.name: maker for maker in makers}
    if set(chosen) != set(METHODS):
        raise InvalidInput(f"method: this study compares {', '.join(METHODS)}, got {', '.join(chosen)}; leave it out.")
    rows: list[dict[str, object]] = []
    with limited_threads(threads), progress(console, "pairs", study.pairs) as advance:
        for case in cases(study, dataset):
            rows += measured(study, chosen, case)
            advance(1)
    records = pd.DataFrame(rows)
    summary = records.groupby(["measure", "row", "shapes"], sort=False)["mm"].mean().reset_index()
    write(study, records, summary, _panels(summary), folder, console)


def measured(study: ShapesStudy, makers: Mapping[str, MethodMaker], case: Case) -> list[dict[str, object]]:
    """Errors in mm of every expression, by measure, row and number of shapes."""
    rows: list[dict[str, object]] = []

    def add(measure: str, row: str, count: int, values: np.ndarray, names: tuple[str, ...]) -> None:
        about = {"source": case.source, "target": case.target, "measure": measure, "row": row, "shapes": count}
        rows.extend({**about, "expression": name, "mm": value} for name, value in zip(names, values, strict=True))

    alm = makers["alm"].serving(case.problem).prepare(case.pair)
    lbs = makers["lbs"].serving(case.problem).prepare(case.pair)
    whole = alm.fit(case.first(study.counts[-1]), case.span)(case.frames).frames
    for count in study.counts:
        examples = case.first(count)
        local, wide = (prepared.fit(examples, case.span)(case.frames) for prepared in (alm, lbs))
        for row, result in ((LOCAL, local), (GLOBAL, wide)):
            rebuilt = case.error(result.parts["source_reconstruction"], case.frames)
            add("source rebuilt", row, count, rebuilt, case.tests)  # Fig. 14
        add("against all shapes", "alm", count, case.error(local.frames, whole), case.tests)  # Fig. 15
        for row, result in (("alm", local), ("lbs", wide)):
            add("against the truth", row, count, case.error(result.frames, case.truth), case.tests)
    known = case.first(study.counts[-1])
    assert known.source is not None
    names = tuple(f"shape {i}" for i in range(known.count))
    tuned = alm.fit(known, case.span)(known.source).frames
    add("own examples", "alm", known.count, case.error(tuned, known.target), names)
    for unit, length in UNITS.items():
        paper = makers["alm_paper"](length_mm=length).prepare(case.pair)
        found = paper.fit(known, case.span)(known.source).frames
        add("own examples", f"alm_paper in {unit}", known.count, case.error(found, known.target), names)
    return rows


def _panels(summary: pd.DataFrame) -> list[Panel]:
    panels = []
    for measure in ("source rebuilt", "against all shapes", "against the truth"):
        mine = summary[summary["measure"] == measure]
        curves = {
            str(row): dict(zip(part["shapes"].astype(float), part["mm"], strict=True))
            for row, part in mine.groupby("row", sort=False)
        }
        panels.append(Panel(measure, "shapes", curves))
    return panels
