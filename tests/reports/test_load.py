"""Results folders: what is read, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from reports.load import load
from retarget.check import InvalidInput
from tests.reports.example_study import write_example_study


def test_a_folder_is_read_back(tmp_path: Path) -> None:
    (study,) = load([write_example_study(tmp_path / "one")])
    assert study.tested == ("delta", "sumner_popovic", "lbs", "plbs", "plbs_residual")
    assert set(study.primary["region"]) == {"head"}
    cell = study.figure_cells[0]
    error = cell.frames.error(0)
    outside = np.setdiff1d(np.arange(len(error)), cell.frames.head)
    assert np.isnan(error[outside]).all()
    rows = study.metrics[study.metrics["expression"] == cell.frames.expressions[0]]
    for name, value in {"method": cell.method, "source": cell.source, "target": cell.target, "draw": cell.draw}.items():
        rows = rows[rows[name] == value]
    rows = rows[(rows["n_examples"] == cell.n_examples) & (rows["metric"] == "vertex_l2_mean")]
    assert float(rows[rows["region"] == "head"]["value"].iloc[0]) == pytest.approx(np.nanmean(error), rel=1e-5)


def test_sweep_folders_are_told_apart_by_what_differs(tmp_path: Path) -> None:
    for name, noise in (("0", 0.0), ("1", 0.3)):
        write_example_study(tmp_path / name, noise_mm=noise)
    studies = load([tmp_path])  # the folder that holds them
    assert [study.differs for study in studies] == ["dataset.noise_mm=0.0", "dataset.noise_mm=0.3"]
    assert len(load([tmp_path / "0", tmp_path / "0"])) == 1


def test_folders_with_equal_settings_are_told_apart_by_name(tmp_path: Path) -> None:
    folders = [write_example_study(tmp_path / name) for name in ("first", "second")]
    assert [study.differs for study in load(folders)] == ["first", "second"]


def _schema(folder: Path) -> None:
    facts = json.loads((folder / "study.json").read_text())
    (folder / "study.json").write_text(json.dumps(facts | {"schema": 0}))


def _entry(folder: Path) -> None:
    facts = json.loads((folder / "study.json").read_text())
    del facts["provenance"]
    (folder / "study.json").write_text(json.dumps(facts))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_schema, r"schema 0, this version reads schema 1"),
        (_entry, r"expected the entries provenance"),
        (lambda folder: (folder / "study.json").write_text("{"), r"expected JSON"),
        (lambda folder: (folder / "study.json").write_text("[]"), r"schema None"),
        (lambda folder: (folder / "study.json").unlink(), r"expected a results folder with a study.json"),
        (lambda folder: (folder / "cells.parquet").unlink(), r"did not finish"),
        (lambda folder: (folder / "metrics.parquet").write_bytes(b"PAR1"), r"cannot be read"),
        (lambda folder: (folder / "cells.parquet").write_bytes((folder / "metrics.parquet").read_bytes()), r"columns"),
        (lambda folder: (folder / "metrics.parquet").write_bytes((folder / "cells.parquet").read_bytes()), r"missing"),
        (lambda folder: (folder / "summary.csv").write_text(""), r"cannot be read"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path: Path, spoil: Callable[[Path], object], message: str) -> None:
    folder = write_example_study(tmp_path / "results", identities=2, draws=1)
    spoil(folder)
    with pytest.raises(InvalidInput, match=message):
        load([folder])


def test_no_folder_is_refused() -> None:
    with pytest.raises(InvalidInput, match="at least one results folder"):
        load([])
