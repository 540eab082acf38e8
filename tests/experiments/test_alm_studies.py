"""The three studies of ALM on blocks with a mouth."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from experiments.alm_leave_out import LeaveOutStudy, leave_out
from experiments.alm_overlap import OverlapStudy, borders, vary
from experiments.alm_shapes import ShapesStudy, grow
from experiments.alm_study import AlmStudy, cases
from experiments.catalogue import MethodMaker
from retarget.check import InvalidInput
from retarget.rig.local_model.layout import OverlappingPatches
from tests.conformance.box import heads_are_boxes
from tests.experiments.block import block
from tests.synthetic import ball

COMMON = {"title": "", "description": "", "seed": 0, "pairs": 1, "expressions": 2, "shapes": 6}
SHAPES = {**COMMON, "name": "alm_shapes", "counts": [2, 6]}
OVERLAP = {
    **COMMON,
    "name": "alm_overlap",
    "rings": [0, 3],
    "lambda_overlap": [0.0, 1e6],
}
LEAVE_OUT = {**COMMON, "name": "alm_leave_out", "folds": 2, "shown": 1}


@pytest.fixture(autouse=True)
def small() -> Iterator[None]:
    with heads_are_boxes(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("reports.leave_out_sheet.SIZE", (60, 72))
        yield


def makers(*names: str) -> list[MethodMaker]:
    return [MethodMaker.of(name) for name in names]


def console() -> Console:
    return Console(file=io.StringIO(), width=200)


def test_more_shapes_rebuild_the_source_better(tmp_path: Path) -> None:
    grow(ShapesStudy.from_config(SHAPES), makers("alm", "alm_paper", "lbs"), block(), 1, tmp_path, console())
    summary = pd.read_csv(tmp_path / "summary.csv").set_index(["measure", "row", "shapes"])["mm"]
    for row in ("patches", "global blendshapes"):
        assert summary["source rebuilt", row, 6] < summary["source rebuilt", row, 2]
    assert summary["source rebuilt", "patches", 2] < summary["source rebuilt", "global blendshapes", 2]
    assert summary["against all shapes", "alm", 6] == 0
    shrunk = [summary["own examples", f"alm_paper in {unit}", 6] for unit in ("millimetres", "centimetres", "metres")]
    assert summary["own examples", "alm", 6] < 0.1
    assert shrunk == sorted(shrunk)
    assert (tmp_path / "alm_shapes.pdf").read_bytes().startswith(b"%PDF")


def test_overlap_closes_gaps_and_coupling_costs_expression(tmp_path: Path) -> None:
    vary(OverlapStudy.from_config(OVERLAP), MethodMaker.of("alm_patch_only_paper"), block(), 1, tmp_path, console())
    summary = pd.read_csv(tmp_path / "summary.csv").set_index(["variable", "value"])
    jump = summary["jump between patches"]
    assert jump["rings", 3] < jump["rings", 0]
    rebuilt = summary["source rebuilt"]
    assert rebuilt["lambda_overlap", 1e6] > rebuilt["lambda_overlap", 0.0]
    assert (tmp_path / "alm_overlap.pdf").read_bytes().startswith(b"%PDF")


def test_every_shape_is_held_out_at_most_once(tmp_path: Path) -> None:
    leave_out(LeaveOutStudy.from_config(LEAVE_OUT), makers("alm", "lbs", "delta"), block(), 1, tmp_path, console())
    records = pd.read_csv(tmp_path / "records.csv")
    held = records[records["method"] == "alm"]
    assert held["shape"].is_unique
    assert len(held) == 4
    assert list(pd.read_csv(tmp_path / "summary.csv")["method"]) == ["alm", "lbs", "delta"]
    assert (tmp_path / "alm_leave_out.pdf").read_bytes().startswith(b"%PDF")


def test_shapes_that_move_most_come_first_and_none_is_tested() -> None:
    [case] = cases(AlmStudy.from_config({**COMMON, "name": "x"}), block())
    moved = np.linalg.norm(case.shapes.source - case.pair.source_neutral, axis=2).mean(axis=1)
    assert (np.diff(moved) <= 0).all()
    assert not set(case.names) & set(case.tests)
    np.testing.assert_array_equal(case.first(3).target, case.shapes.target[:3])


def test_borders_join_the_cores_of_two_patches() -> None:
    vertices, faces = ball()
    layout = OverlappingPatches.of(faces, len(vertices), 8, 1)
    inside = np.flatnonzero(vertices[:, 2] > 0)
    edges = borders(layout, faces, inside)
    assert np.isin(edges, inside).all()
    for a, b in edges:
        assert not any(np.isin([a, b], core).all() for core in layout.cores)


@pytest.mark.parametrize(
    ("kind", "config", "change", "message"),
    [
        (ShapesStudy, SHAPES, {"counts": [6, 2]}, "ascending"),
        (ShapesStudy, SHAPES, {"counts": [2, 9]}, "at most study.shapes"),
        (ShapesStudy, SHAPES, {"pairs": 0}, "study.pairs"),
        (OverlapStudy, OVERLAP, {"rings": [-1]}, "study.rings"),
        (LeaveOutStudy, LEAVE_OUT, {"folds": 9}, "study.folds"),
        (LeaveOutStudy, LEAVE_OUT, {"fold": 2}, "study.fold: no setting of this study, .* Did you mean 'folds'"),
    ],
)
def test_settings_out_of_range_are_refused(
    kind: type[AlmStudy], config: dict[str, object], change: dict[str, object], message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        kind.from_config({**config, **change})


def test_methods_of_another_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"rings.*got lbs"):
        vary(OverlapStudy.from_config(OVERLAP), MethodMaker.of("lbs"), block(), 1, tmp_path, console())
    with pytest.raises(InvalidInput, match="compares alm, alm_paper, lbs, got alm"):
        grow(ShapesStudy.from_config(SHAPES), makers("alm"), block(), 1, tmp_path, console())
