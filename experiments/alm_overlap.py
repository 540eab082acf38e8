"""Overlap of patches and coupling of their coefficients in ALM: Figs 12 and 13 of Chandran et al. 2022."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from baselines.alm import AnatomicalLocalModels
from experiments.alm_study import AlmStudy, Case, cases, write
from experiments.backend import limited_threads
from experiments.catalogue import MethodMaker
from experiments.progress import progress
from reports.curves_sheet import Panel
from retarget.check import InvalidInput, check_whole
from retarget.geometry.graph import vertex_adjacency
from retarget.rig.local_model.layout import OverlappingPatches
from retarget.types import FloatArray, IntArray
from synth_data.dataset import Dataset

MEASURES = ("source rebuilt", "against the truth", "jump between patches")
VARIABLES = {"rings": "rings of overlap", "lambda_overlap": "lambda_O"}


@dataclass(frozen=True, kw_only=True)
class OverlapStudy(AlmStudy):
    """``conf/study/alm_overlap.yaml``."""

    rings: list[int]
    lambda_overlap: list[float]

    def check(self) -> None:
        for name in VARIABLES:
            listed = getattr(self, name)
            if not isinstance(listed, list) or not listed:
                raise InvalidInput(f"study.{name}: expected a list of values, got {listed!r}.")
        for value in self.rings:
            check_whole("study.rings", value, 0)


def vary(
    study: OverlapStudy, maker: MethodMaker, dataset: Dataset, threads: int, folder: Path, console: Console
) -> None:
    """Run the study and write ``records.csv``, ``summary.csv`` and ``alm_overlap.pdf``.

    The method is taken without its second step, as in Fig. 13. Raises InvalidInput unless it is one of ALM.
    """
    rows: list[dict[str, object]] = []
    with limited_threads(threads), progress(console, "pairs", study.pairs) as advance:
        for case in cases(study, dataset):
            for variable in VARIABLES:
                for value in getattr(study, variable):
                    rows += measured(maker, case, variable, value)
            advance(1)
    records = pd.DataFrame(rows)
    summary = records.groupby(["variable", "value"], sort=False)[list(MEASURES)].mean().reset_index()
    write(study, records, summary, _panels(summary), folder, console)


def measured(maker: MethodMaker, case: Case, variable: str, value: float) -> list[dict[str, object]]:
    """A row for each expression."""
    method = maker.serving(case.problem, **{variable: value})
    if not isinstance(method, AnatomicalLocalModels):
        raise InvalidInput(
            f"method: this study is of ALM, got {maker.name}; choose one with 'method=[alm_patch_only]'."
        )
    fitted: Any = method.prepare(case.pair).fit(case.shapes, case.span)
    result = fitted(case.frames)
    edges = borders(fitted.target.layout, case.pair.faces, case.head)
    layout, blendshapes = fitted.target.layout, fitted.target
    jumps = [
        _jump(blendshapes.at_places(alpha), layout, edges, truth)
        for alpha, truth in zip(fitted.patches(case.frames).alpha, case.truth, strict=True)
    ]
    columns = {
        MEASURES[0]: case.error(result.parts["source_reconstruction"], case.frames),
        MEASURES[1]: case.error(result.frames, case.truth),
        MEASURES[2]: np.array(jumps),
    }
    about = {"source": case.source, "target": case.target, "variable": variable, "value": value}
    return [
        {**about, "expression": name, **{measure: values[i] for measure, values in columns.items()}}
        for i, name in enumerate(case.tests)
    ]


def borders(layout: OverlappingPatches, faces: IntArray, within: IntArray) -> IntArray:
    """(e, 2) edges of the mesh whose ends belong to the cores of two patches, within some vertices."""
    label = np.empty(len(layout.multiplicity), dtype=np.int64)
    for p, core in enumerate(layout.cores):
        label[core] = p
    edges = np.stack(vertex_adjacency(faces, len(label)).nonzero(), axis=1).astype(np.int64)
    kept = (edges[:, 0] < edges[:, 1]) & (label[edges[:, 0]] != label[edges[:, 1]])
    return edges[kept & np.isin(edges, within).all(axis=1)]


def _jump(at_places: FloatArray, layout: OverlappingPatches, edges: IntArray, truth: FloatArray) -> float:
    """mm: how much the error jumps along edges where each vertex follows the patch whose core it is in."""
    own = np.empty_like(truth)
    for members, core, places in zip(layout.members, layout.cores, layout.places, strict=True):
        own[core] = at_places[places][np.searchsorted(members, core)]
    error = own - truth
    return float(np.linalg.norm(error[edges[:, 0]] - error[edges[:, 1]], axis=1).mean())


def _panels(summary: pd.DataFrame) -> list[Panel]:
    panels = []
    for variable, said in VARIABLES.items():
        mine = summary[summary["variable"] == variable]
        places = np.arange(len(mine), dtype=float)
        curves = {measure: dict(zip(places, mine[measure], strict=True)) for measure in MEASURES}
        ticks = {float(i): f"{value:g}" for i, value in zip(places, mine["value"], strict=True)}
        panels.append(Panel("", said, curves, ticks=ticks))
    return panels
