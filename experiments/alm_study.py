"""What the studies of ALM share: pairs with drawn shapes, errors on the visible head, and a sheet of curves."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
from rich.console import Console

from experiments.collision import chosen_pairs
from experiments.progress import print_path
from experiments.protocol import draw
from experiments.study import check_settings
from reports.curves_sheet import Panel, write_curves_sheet
from retarget.check import InvalidInput, check_whole
from retarget.io.files import write_whole
from retarget.types import Examples, FloatArray, IntArray, Pair, RetargetProblem
from synth_data.dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class AlmStudy:
    """What every ``conf/study/alm_*.yaml`` says. shapes: the most examples of a pair, the neutral not counted."""

    name: str
    title: str
    description: str
    seed: int
    pairs: int
    expressions: int
    shapes: int

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Self:
        """Raises InvalidInput for a value that the study cannot have."""
        check_settings("study", config, cls)
        study = cls(**config)
        for name in ("pairs", "expressions", "shapes"):
            check_whole(f"study.{name}", getattr(study, name), 1)
        study.check()
        return study

    def check(self) -> None:
        """Raises InvalidInput for a value of this kind of study that it cannot have."""


@dataclass(frozen=True)
class Case:
    """A pair of people, shapes of both, and expressions that are none of them; all but the truth as scanned."""

    source: str
    target: str
    pair: Pair
    shapes: Examples  # those that move most first
    true_shapes: FloatArray  # (k, n, 3) mm of the target, without the scanner's noise
    names: tuple[str, ...]  # of the shapes
    span: FloatArray  # (N, n, 3) mm: the animation, all expressions of the source
    tests: tuple[str, ...]
    frames: FloatArray  # (t, n, 3) mm of the source
    truth: FloatArray  # (t, n, 3) mm of the target

    @property
    def problem(self) -> RetargetProblem:
        """What a method is asked that knows all shapes."""
        return RetargetProblem.of(self.pair, self.shapes, self.span)

    def first(self, count: int) -> Examples:
        """The `count` shapes that move most."""
        assert self.shapes.source is not None
        return Examples(self.shapes.target[:count], self.shapes.source[:count])

    @property
    def head(self) -> IntArray:
        """(h,) the visible skin."""
        every = np.arange(len(self.pair.target_neutral))
        return np.asarray(self.pair.regions.vertices.get("head", every), dtype=np.int64)

    def error(self, found: FloatArray, wanted: FloatArray) -> FloatArray:
        """(t,) mm, mean vertex distance on the visible head."""
        distance: FloatArray = np.linalg.norm((found - wanted)[:, self.head], axis=2).mean(axis=1)
        return distance


def cases(study: AlmStudy, dataset: Dataset) -> Iterator[Case]:
    """The study's pairs. Raises InvalidInput where the dataset has too few expressions."""
    needed = study.expressions + study.shapes
    if len(dataset.expressions) < needed:
        raise InvalidInput(
            f"dataset: expected at least {needed} expressions ({study.shapes} shapes that methods know and "
            f"{study.expressions} that are tested), got {len(dataset.expressions)}; ask for fewer with study.shapes "
            "and study.expressions."
        )
    for source, target in chosen_pairs(dataset.identities, study.pairs):
        drawn = draw(source, target, 0, len(dataset.expressions), study.expressions, study.seed)
        chosen = np.array(drawn.examples(study.shapes))
        motion = dataset.frames(source, chosen.tolist()) - dataset.neutral(source)
        moving = np.argsort(-np.linalg.norm(motion, axis=2).mean(axis=1), kind="stable")
        shown, known = dataset.scanned(source, chosen.tolist()), chosen[moving].tolist()
        yield Case(
            source,
            target,
            dataset.scanned_pair(source, target),
            Examples(dataset.scanned(target, known), shown[moving]),
            dataset.frames(target, known),
            tuple(dataset.expressions[i] for i in known),
            dataset.scanned(source, range(len(dataset.expressions))),
            tuple(dataset.expressions[i] for i in drawn.test),
            dataset.scanned(source, drawn.test),
            dataset.frames(target, drawn.test),
        )


def write(
    study: AlmStudy,
    records: pd.DataFrame,
    summary: pd.DataFrame,
    panels: Sequence[Panel],
    folder: Path,
    console: Console,
) -> None:
    """``records.csv``, ``summary.csv`` and ``<name>.pdf`` with curves, whole or not at all."""
    with tempfile.TemporaryDirectory(prefix="sheet-") as work:
        write_curves_sheet(folder / f"{study.name}.pdf", study.title, study.description, panels, summary, Path(work))
    save(study, records, summary, folder, console)


def save(study: AlmStudy, records: pd.DataFrame, summary: pd.DataFrame, folder: Path, console: Console) -> None:
    """The two tables, and on the console the summary and where all lies."""
    for name, table in (("records", records), ("summary", summary)):
        write_whole(folder / f"{name}.csv", lambda path, table=table: table.to_csv(path, index=False))  # type: ignore[misc]
    console.print(
        summary.to_string(index=False, float_format=lambda value: f"{value:.4f}"), markup=False, soft_wrap=True
    )
    for name in ("records.csv", "summary.csv", f"{study.name}.pdf"):
        print_path(folder / name, console)


def summary_of_errors(records: pd.DataFrame, first: str) -> pd.DataFrame:
    """A row for each method: mean and median error in mm, and the share of shapes where `first` has less error."""
    wide = records.pivot_table(index=["source", "target", "shape"], columns="method", values="mm", sort=False)
    rows = [
        {
            "method": method,
            "mean_mm": wide[method].mean(),
            "median_mm": wide[method].median(),
            f"{first}_is_closer": "" if method == first else f"{(wide[first] < wide[method]).mean():.0%}",
        }
        for method in dict.fromkeys(records["method"])
    ]
    return pd.DataFrame(rows)
