"""Results folders: what is read, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
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


def _start(folder: Path, started: str, truth: str = "nonlinear", listed: list[str] | None = None) -> Path:
    write_example_study(folder, identities=2, draws=1, failures=False)
    _set("provenance", "started", to=f"2026-01-02T{started}+00:00")(folder)
    _set("dataset", "truth", to=truth)(folder)
    _set("config", to={"dataset": {"truth": truth}} | ({"conditions": listed} if listed else {}))(folder)
    return folder


@pytest.mark.parametrize("listed", [False, True])
def test_the_same_folders_have_one_order_with_sanity_last(tmp_path: Path, listed: bool) -> None:
    """As the configuration lists them, else as they were started; never as they were named, or by the alphabet."""
    names = ["quiet", "personal", "additive", "loud"]
    starts = reversed(range(4)) if listed else range(4)
    folders = [
        _start(tmp_path / name, f"0{i}:00:00", name if name == "additive" else "linear", names if listed else None)
        for name, i in zip(names, starts, strict=True)
    ]
    for given in (folders, folders[::-1], [tmp_path]):
        assert [study.folder.name for study in load(given)] == ["quiet", "personal", "loud", "additive"]


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


def _set(*path: str, to: object) -> Callable[[Path], None]:
    """Set one entry of study.json."""

    def spoil(folder: Path) -> None:
        facts = json.loads((folder / "study.json").read_text())
        inner = facts
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = to
        (folder / "study.json").write_text(json.dumps(facts))

    return spoil


def _change(name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Callable[[Path], None]:
    """Change one of the tables."""

    def spoil(folder: Path) -> None:
        path = folder / f"{name}.parquet"
        change(pd.read_parquet(path)).to_parquet(path, index=False)

    return spoil


def _without(name: str, **cell: object) -> Callable[[Path], None]:
    """Leave the rows of one cell out."""
    return _change(name, lambda table: table[~np.logical_and.reduce([table[key] == of for key, of in cell.items()])])


def _some_in_cm(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(unit=np.where(table["method"] == "lbs", "cm", "mm"))


def _one_infinite(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(value=np.where((table["method"] == "plbs") & (table["draw"] == 0), np.inf, table["value"]))


ROW = {"name": "delta", "label": "delta", "description": "", "kind": "method", "settings": {}}
CELL = {"method": "plbs", "source": "person_00", "target": "person_01", "n_examples": 15, "draw": 0}


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_change("metrics", lambda t: t.assign(value=t["value"].astype(str))), "metrics.*: expected numbers .* value"),
        (_change("metrics", lambda t: t.iloc[:0]), r"metrics.parquet: expected at least one row, got none"),
        (_change("cells", lambda t: t.iloc[:0]), r"cells.parquet: expected at least one row, got none"),
        (_change("metrics", _some_in_cm), r"metrics.parquet: expected one unit of vertex_l2_mean, got mm and cm"),
        (_change("metrics", lambda t: pd.concat([t, t])), r"metrics.parquet: expected one row for each .* the first"),
        (_change("cells", lambda t: pd.concat([t, t])), r"cells.parquet: expected one row for each .* 42 rows more"),
        (_change("metrics", _one_infinite), r"expected finite values of all finished cells, got 240 others"),
        (_change("metrics", lambda t: t.assign(draw=0.5)), r"expected whole numbers in the column draw, got 0.5"),
        (_change("metrics", lambda t: t.assign(region=None)), r"expected an entry of the column region in every row"),
        (
            _without("metrics", **CELL),
            r"metrics.parquet: expected the cells of cells.parquet, got all but 1 of 42, .* plbs, per",
        ),
        (_without("cells", **CELL), r"cells.parquet: expected the cells of metrics.parquet, got all but 1 of 42"),
        (_without("metrics", **CELL, expression="expression_002"), r"got 4 of 5 for vertex_l2_mean on head, plbs, per"),
        (_change("cells", lambda t: t.assign(status="failed")), r"expected the status that cells.parquet gives"),
        (_set("primary_metric", to="nonsense"), r"study.json, primary_metric: .*vertex_l2_max.*, got 'nonsense'"),
        (_set("primary_region", to="nose"), r"study.json, primary_region: .*lips.*, got 'nose'"),
        (_set("provenance", to="x"), r"study.json, provenance: expected named entries, got 'x'"),
        (_set("provenance", "finished", to="yesterday"), r"provenance.finished: expected a time, got 'yesterday'"),
        (_set("provenance", to={}), r"expected the entry provenance.project_version"),
        (_set("methods", to=[{}]), r"expected the entry methods\[0\].name"),
        (_set("n_examples", to=["five"]), r"study.json, n_examples\[0\]: expected a whole number, got 'five'"),
        (_set("n_examples", to=[5, 99]), r"study.json, n_examples: expected also 15, 30, .* got 5, 99"),
        (_set("methods", to=[ROW]), r"study.json, methods: expected also sumner_popovic, .*, got delta"),
        (_set("tables", to="x"), r"study.json, tables: expected a list, got 'x'"),
        (_set("measures", to={"lbs": ["x"]}), r"study.json, lbs: expected pairs \(metric, region\), got \['x'\]"),
        (_set("identities", to=[]), r"study.json, identities: expected at least one entry"),
    ],
)
def test_tables_that_are_not_whole_are_refused_in_one_line(
    tmp_path: Path, spoil: Callable[[Path], None], message: str
) -> None:
    folder = write_example_study(tmp_path / "results", identities=2, draws=1, failures=False)
    for path in folder.glob("*/frames.npz"):
        path.unlink()
    spoil(folder)
    with pytest.raises(InvalidInput, match=message) as refused:
        load([folder])
    said = str(refused.value)
    assert str(folder) in said
    assert "run it again" in said
    assert "\n" not in said


def test_a_summary_that_tables_outgrew_is_not_believed(tmp_path: Path) -> None:
    """Both tables cut to one pair: the summary is made of them, whatever summary.csv says."""
    folder = write_example_study(tmp_path / "results", identities=3, draws=1, failures=False)
    (whole,) = load([folder])
    pd.testing.assert_frame_equal(whole.summary, pd.read_csv(folder / "summary.csv"), check_dtype=False)
    assert set(whole.summary["n_pairs"]) == {6}
    for name in ("metrics", "cells"):
        _change(name, lambda t: t[(t["source"] == "person_00") & (t["target"] == "person_01")])(folder)
    (cut,) = load([folder])
    assert set(cut.summary["n_pairs"]) == {1}
    assert cut.primary["mean"].notna().all()


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
