"""The study of artistic control on blocks with a mouth."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from rich.console import Console

from experiments.artistic import ArtisticStudy, intervene
from experiments.catalogue import MethodMaker
from retarget.check import InvalidInput
from tests.conformance.box import heads_are_boxes
from tests.experiments.block import block

STAY = [0.0, 0.0, 0.0]
METHOD = MethodMaker.of("anacondar")
SETTINGS: dict[str, Any] = {
    "name": "artistic",
    "title": "Edits",
    "description": "",
    "seed": 0,
    "n_examples": 4,
    "expression": "expression_002",
    "edits": {
        "contour": {"control_points": {"labrale_superius": [0.0, 1.5, 0.5], "infradentale": STAY}},
        "nothing": {"gravity": [0.0, -9.81, 0.0]},
        "strength": {"patch_weights": {"cranium_skin": 2.0}},
    },
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the study leaves behind."""
    folder = tmp_path_factory.mktemp("artistic")
    with heads_are_boxes(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("reports.artistic_sheet.SIZE", (96, 72))
        intervene(
            ArtisticStudy.from_config(SETTINGS),
            METHOD,
            block(),
            1,
            folder,
            Console(file=io.StringIO()),
        )
    return folder


def test_each_edit_has_its_line(folder: Path) -> None:
    table = pd.read_csv(folder / "summary.csv").set_index("edit")
    assert list(table.index) == list(SETTINGS["edits"])
    assert table.loc["nothing", "moved_max_mm"] == 0
    assert (table.loc[["contour", "strength"], "moved_max_mm"] > 0.3).all()
    assert table["contour_before_mm"].notna().tolist() == [True, False, False]


def test_the_contour_arrives(folder: Path) -> None:
    row = pd.read_csv(folder / "summary.csv").set_index("edit").loc["contour"]
    assert row["contour_before_mm"] > 0.3
    assert row["contour_after_mm"] < 0.1 * row["contour_before_mm"]


def test_the_page_is_a_pdf(folder: Path) -> None:
    assert (folder / "artistic.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edits": {}}, "study.edits: expected edits by their titles"),
        ({"n_examples": -1}, "study.n_examples"),
        ({"edit": {}}, r"study\.edit: no setting of this study, .* Did you mean 'edits'"),
    ],
)
def test_settings_out_of_range_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        ArtisticStudy.from_config(SETTINGS | change)


def test_an_unknown_expression_is_refused(tmp_path: Path) -> None:
    study = ArtisticStudy.from_config({**SETTINGS, "expression": "expression_02"})
    with heads_are_boxes(), pytest.raises(InvalidInput, match="Did you mean 'expression_002'"):
        intervene(study, METHOD, block(), 1, tmp_path, Console(file=io.StringIO()))
