"""Artistic control of one result (Fig. 15 of the paper): edits, each beside the result without it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from experiments.backend import limited_threads
from experiments.catalogue import MethodMaker
from experiments.collision import chosen_pairs
from experiments.progress import Advance, print_path, progress
from experiments.protocol import draw
from experiments.study import check_settings
from reports.artistic_sheet import Panel, write_artistic_sheet
from reports.terminal import print_edits
from retarget.artistic import Edits
from retarget.check import InvalidInput, check_whole
from retarget.geometry.patches import contiguous_patches
from retarget.geometry.space_warp import space_warp
from retarget.io.files import write_whole
from retarget.rig.blendshapes import Patches
from retarget.suggest import choose
from retarget.types import Examples, Fitted, FloatArray, IntArray, Pair, RetargetProblem, RetargetResult
from synth_data.dataset import Dataset

MOVED = 0.1  # mm: what moves less has not


@dataclass(frozen=True)
class ArtisticStudy:
    """``conf/study/artistic.yaml``."""

    name: str
    title: str
    description: str
    seed: int
    n_examples: int
    expression: str | None  # of the dataset; None: the one in which the first identity moves most
    edits: Mapping[str, Mapping[str, Any]]

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> ArtisticStudy:
        """Raises InvalidInput for a value that the study cannot have."""
        check_settings("study", config, ArtisticStudy)
        study = ArtisticStudy(**config)
        check_whole("study.n_examples", study.n_examples, 0)
        if not isinstance(study.edits, Mapping) or not study.edits:
            raise InvalidInput(f"study.edits: expected edits by their titles, got {study.edits!r}.")
        return study


@dataclass(frozen=True)
class Scene:
    """One expression of a pair, and the method that retargets it."""

    expression: str
    pair: Pair
    fitted: Fitted
    patches: Patches  # of the method
    frame: FloatArray  # (1, n, 3) mm of the source
    unedited: RetargetResult

    @property
    def contour(self) -> IntArray:
        """(k,) skin vertices."""
        return np.asarray(self.pair.regions.loops.get("lip_contour", ()), dtype=np.int64)


def intervene(
    study: ArtisticStudy, make: MethodMaker, dataset: Dataset, threads: int, folder: Path, console: Console
) -> None:
    """Run the study and write ``summary.csv`` and ``artistic.pdf``."""
    with limited_threads(threads), progress(console, "edits", len(study.edits)) as advance:
        shown = scene(study, make, dataset)
        panels = edited(study, shown, advance)
    table = pd.DataFrame([{"edit": panel.title, **panel.numbers} for panel in panels])
    write_whole(folder / "summary.csv", lambda path: table.to_csv(path, index=False))
    with tempfile.TemporaryDirectory(prefix="sheet-") as work:
        source, target = dataset.identities[:2]
        what = (
            f"{study.description} Expression {shown.expression} of {source} on {target}, {study.n_examples} examples."
        )
        write_artistic_sheet(folder / "artistic.pdf", study.title, what, panels, Path(work))
    print_edits(table, console)
    for name in ("summary.csv", "artistic.pdf"):
        print_path(folder / name, console)


def scene(study: ArtisticStudy, make: MethodMaker, dataset: Dataset) -> Scene:
    """The first identity performs, the second answers. Raises InvalidInput where the study or the method cannot."""
    [(source, target)] = chosen_pairs(dataset.identities, 1)
    if study.expression is None:
        expression = _liveliest(dataset, source)
    else:
        expression = dataset.expressions.index(choose("study.expression", study.expression, dataset.expressions))
    pair = dataset.scanned_pair(source, target)
    order = draw(source, target, 0, len(dataset.expressions), 0, study.seed).order
    examples = [i for i in order if i != expression][: study.n_examples]
    known = Examples(dataset.scanned(target, examples), dataset.scanned(source, examples))
    frame = dataset.scanned(source, [expression])
    method = make.serving(RetargetProblem.of(pair, known, frame))
    fitted = method.prepare(pair).fit(known, frame)
    patches = contiguous_patches(pair.faces, len(frame[0]), make.settings.get("patch_count", 80))
    return Scene(dataset.expressions[expression], pair, fitted, patches, frame, fitted(frame))


def _liveliest(dataset: Dataset, identity: str) -> int:
    """The expression in which someone's visible skin moves most."""
    rest = dataset.neutral(identity)
    head = dataset.regions.vertices.get("head", np.arange(len(rest)))
    motion = [
        np.linalg.norm((dataset.frames(identity, [i])[0] - rest)[head], axis=1).mean()
        for i in range(len(dataset.expressions))
    ]
    return int(np.argmax(motion))


def edited(study: ArtisticStudy, of: Scene, advance: Advance = lambda count: None) -> list[Panel]:
    """A panel for each edit."""
    panels = []
    for title, edits in study.edits.items():
        started = time.perf_counter()
        result = of.fitted(of.frame, edits)
        took = time.perf_counter() - started
        before, after = of.unedited.frames[0], result.frames[0]
        moved = np.linalg.norm(after - before, axis=1)
        regions = of.pair.regions.vertices
        seen = regions.get("head", np.arange(len(moved)))
        control, wanted = _wanted(of, edits, before)
        numbers: dict[str, Any] = {
            "moved_mean_mm": moved[seen].mean(),
            "moved_max_mm": moved[seen].max(),
            "moved_share": (moved[seen] > MOVED).mean(),
            "cranium_max_mm": moved[regions["cranium"]].max() if "cranium" in regions else np.nan,
            "contour_before_mm": _mean_distance(before[of.contour], wanted),
            "contour_after_mm": _mean_distance(after[of.contour], wanted),
            "contour_after_max_mm": _distance(after[of.contour], wanted).max(initial=0.0) if len(wanted) else np.nan,
            "status": str(result.info[0].status),
            "iterations": result.info[0].iterations,
            "seconds": took,
        }
        panels.append(Panel(title, edits, numbers, of.pair, before, after, control, wanted))
        advance(1)
    return panels


def _wanted(of: Scene, edits: Mapping[str, Any], before: FloatArray) -> tuple[IntArray, FloatArray]:
    """Control points on the contour, and the contour (k, 3) mm that they ask for; nothing without any."""
    control = Edits.of(edits, of.pair.regions, of.patches).control
    leads = np.isin(control.vertices, of.contour)
    if not leads.any():
        return control.vertices, np.empty((0, 3))
    warp = space_warp(before[control.vertices[leads]], control.displacements(before)[leads])
    return control.vertices, before[of.contour] + warp(before[of.contour])


def _distance(points: FloatArray, wanted: FloatArray) -> FloatArray:
    distances: FloatArray = np.linalg.norm(points - wanted, axis=1)
    return distances


def _mean_distance(points: FloatArray, wanted: FloatArray) -> float:
    return float(_distance(points, wanted).mean()) if len(wanted) else float("nan")
