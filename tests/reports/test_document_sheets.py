"""Sheets of studies that are no comparison, inside a document: collisions, artistic control."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pypdf import PdfReader

from reports import artistic_sheet, collision_sheet
from reports.artistic_sheet import Panel, write_artistic_sheet
from reports.collision_sheet import Case, write_collision_sheet
from reports.folders import gather
from reports.report import describe, typeset
from retarget.types import Pair, Regions
from tests.reports.example_study import ball

VERTICES, FACES = ball()
LIP = int(np.argmax(VERTICES[:, 2]))  # the foremost vertex
RING = np.flatnonzero(np.abs(VERTICES[:, 1] - 40) < 12)[:6]
PAIR = Pair(FACES, VERTICES, VERTICES, Regions(landmarks={"stomion_upper": LIP}, loops={"lip_contour": RING}))
MOVED = VERTICES + 0.5 * np.eye(len(VERTICES))[LIP][:, None]


def _collisions(folder: Path, work: Path) -> None:
    row = {"expression": "kiss", "source": "ada", "target": "ben", "depth_before_mm": 1.25, "depth_after_mm": 0.04}
    case = Case(row, PAIR, VERTICES, MOVED, LIP, np.linalg.norm(VERTICES - VERTICES[LIP], axis=1))
    names = ("depth_before_median_mm", "depth_before_max_mm", "depth_after_median_mm", "depth_after_max_mm")
    counts = {"pair": "ada to ben", "expressions": 9, "crossing": 4, "resolved": 3, "truth_crossing": 1}
    summary = pd.DataFrame(
        [
            counts
            | dict(zip(names, (0.5, 1.25, 0.01, 0.04), strict=True))
            | {"seconds_before": 0.1, "seconds_after": 2.0}
        ]
    )
    spread = pd.DataFrame(
        {"from_mm": [0.0, 10.0], "to_mm": [10.0, 20.0], "moved_mean_mm": [0.5, 0.01], "moved_max_mm": [1.0, 0.1]}
    )
    summary.to_csv(folder / "summary.csv", index=False)
    for name in ("cases.csv", "propagation.csv"):
        (folder / name).write_text("a\n1\n")
    write_collision_sheet(
        folder / "collision.pdf", "Lips that cross", "Before and after.", [case], summary, spread, work
    )


def _artistic(folder: Path, work: Path) -> None:
    numbers = {
        "moved_mean_mm": 0.1, "moved_max_mm": 0.5, "moved_share": 0.25, "cranium_max_mm": 0.0,
        "contour_before_mm": 2.0, "contour_after_mm": 0.125, "status": "ok", "seconds": 1.5,
    }  # fmt: skip
    edits = {"stiffness": {"lips": 4.0}}
    panels = [Panel("stiff lips", edits, numbers, PAIR, VERTICES, MOVED, RING[:2], VERTICES[RING] + 1.0)]
    pd.DataFrame([{"edit": "stiff lips", **numbers}]).to_csv(folder / "summary.csv", index=False)
    write_artistic_sheet(folder / "artistic.pdf", "Edits", "With and without.", panels, work)


@pytest.mark.parametrize(
    ("name", "write", "words"),
    [
        ("collision", _collisions, ("Lips that cross", "kiss, ada to ben", "1.25 mm deep", "0.50, 1.25")),
        ("artistic", _artistic, ("Edits", "stiff lips: stiffness of lips × 4", "2.00 to 0.125", "25 %")),
    ],
)
def test_a_sheet_inside_a_document(
    name: str, write: Any, words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (collision_sheet, artistic_sheet):
        monkeypatch.setattr(module, "SIZE", (64, 47))
    folder, work, document = tmp_path / name, tmp_path / "work", tmp_path / "document"
    for each in (folder, work, document):
        each.mkdir()
    write(folder, work)
    gathered = gather([folder])
    assert list(gathered.tables) == [name]
    assert [sheet.study for sheet in gathered.sheets] == [name]
    content = describe(gathered, document, lambda line: None)
    pdf = typeset(content, document)
    assert isinstance(pdf, bytes)
    pages = PdfReader(io.BytesIO(pdf)).pages
    text = " ".join(" ".join(page.extract_text().split()) for page in pages)
    for said in words:
        assert said in text, said
    headings = {heading for heading, _ in content["limits"]}
    assert ("Contact." in headings) == (name != "collision")
    assert sum(len(page.images) for page in pages) >= 2
