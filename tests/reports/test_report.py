"""The PDF: what it says, that it repeats to the byte, and that it is whole or absent."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pypdf import PdfReader

from reports import figures, heads, report
from reports.findings import findings, supported
from reports.folders import gather
from reports.glossary import merged_glossary
from reports.load import load
from reports.report import build_report, describe, typeset
from reports.summary import paired_tests
from reports.tables import (
    correspondence_rows,
    every_measure,
    measure_rows,
    region_rows,
    solve_rows,
    summary_rows,
)
from reports.tables import (
    test_rows as rows_of_tests,
)
from retarget.check import InvalidInput
from tests.reports.example_study import FAMILY, write_example_study


def _pages(path: Path) -> list[str]:
    return _pages_of(path.read_bytes())


def _work(folder: Path) -> Path:
    (folder / "work").mkdir()
    return folder / "work"


def _pages_of(pdf: object) -> list[str]:
    assert isinstance(pdf, bytes)
    reader = PdfReader(io.BytesIO(pdf))
    return [" ".join(page.extract_text().replace("\u200b", "").split()) for page in reader.pages]


@pytest.fixture(scope="module", autouse=True)
def _small_pictures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(heads, "SIZE", (55, 70))
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_example_study(tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def pages(folder: Path) -> list[str]:
    lines: list[str] = []
    path = build_report([folder], None, lines.append)
    assert path == folder / "report.pdf"
    assert lines
    return _pages(path)


def test_every_part_is_there(pages: list[str]) -> None:
    text = " ".join(pages)
    for words in (
        "Quantitative comparison on synthesised ground truth",
        "favours linear methods",
        "Errors on heads: 5 examples, person_00 to person_01",
        "Errors on heads: 30 examples",
        "The peer group with 5 examples",
        "Published claims beside ours",
        "Structure of the methods",
        "What this evaluation cannot show",
        "The worst expression of each method",
        "p sources",
        "plbs residual (control)",
        "about 87 % with 4 people",
        "2000 replicates",
        "vertex_l2_mean on region head in mm",
        "patch_count = none",
        "not over the family",
        "Family incomplete: 8 of 9 tests.",
        "Errors by region",
        "Primary family against plbs",
        "p targets",
        "set-up per pair",
        "How it was measured",
        "seed 0",
        "02 January 2026",
        "regularisation = 0.001",
    ):
        assert words in text, words
    assert len(pages) <= 10
    for words in ("Samples cluster.", "Settings of the methods", "What was run"):
        assert text.count(words) == 1, words  # said once
    for words in ("synthetic.", "cranium", "real recordings", "Failures", "None, "):
        assert words not in text, words


def test_the_table_prints_the_summary(folder: Path, pages: list[str]) -> None:
    summary = pd.read_csv(folder / "summary.csv")
    rows = summary[(summary["metric"] == "vertex_l2_mean") & (summary["region"] == "head")]
    for row in rows[rows["mean"].notna()].itertuples():
        assert f"{row.mean:.3f} [{row.ci_low:.3f}, {row.ci_high:.3f}]" in pages[0]


def test_failed_and_unsupported_cells_are_shown(pages: list[str]) -> None:
    text = " ".join(pages)
    assert "26 of 504 cells have no result" in text
    assert "needs fewer than 20 examples" in text
    assert "LinAlgError: the matrix of patch 17 is singular" in text
    assert "24 of 24" in text
    assert "2 of 24" in text
    assert "no result" in next(page for page in pages if "Errors on heads: 30 examples" in page)


def test_the_same_results_give_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    one = build_report([folder], tmp_path / "one.pdf").read_bytes()
    two = build_report([folder], tmp_path / "two.pdf").read_bytes()
    assert one == two
    assert len(one) < 10e6


def test_measures_are_explained_where_the_study_says_what_they_are(folder: Path, tmp_path: Path) -> None:
    (study,) = load([folder])
    assert merged_glossary([study])["measures"][0] == {"name": "vertex_l2_mean", "unit": "mm", "better": "", "says": ""}
    told = {
        "measures": {
            "vertex_l2_mean": {"says": "mean distance to where they should be", "better": "lower"},
            "vertex_l2_max": {"says": "the other one", "better": "zero"},
        },
        "regions": {"head": "all that is seen", "nose": "never taken"},
        "conditions": {"weights sparse": "few gestures at a time"},
    }
    other = replace(study, facts={**study.facts, "glossary": told})
    made = merged_glossary([study, other])  # the words of any study that has them
    assert [(row["says"], row["better"]) for row in made["measures"]] == [
        ("mean distance to where they should be", "lower"),
        ("the other one", "nearer to 0"),
    ]
    assert made["regions"] == [("head", "all that is seen")]
    assert made["signed"]
    text = " ".join(_pages(build_report([_bare(tmp_path / "told", glossary=told)])))
    for words in ("mean distance to where they should be", "all that is seen", "few gestures at a time"):
        assert words in text, words
    assert "never taken" not in text


def test_several_folders_stand_side_by_side(tmp_path: Path) -> None:
    for name, noise in (("0", 0.0), ("1", 0.3)):
        write_example_study(tmp_path / name, identities=3, draws=1, noise_mm=noise, failures=False)
    path = build_report([tmp_path / "0", tmp_path / "1"])
    assert path == tmp_path / "report.pdf"
    text = " ".join(_pages(path))
    assert "Conditions side by side" in text
    assert "noise_mm 0.3" in text
    assert "0.3 mm noise" in text
    assert "With 3 identities nothing is testable" in text
    assert "not testable" in text
    assert "cells finished." in text


def test_a_study_without_frames_or_tests_still_has_a_report(tmp_path: Path) -> None:
    folder = write_example_study(tmp_path / "bare", identities=2, draws=1, failures=False)
    for frames in folder.glob("*/frames.npz"):
        frames.unlink()
    assert "This study kept no frames" in " ".join(_pages(build_report([folder])))


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(InvalidInput, match="cannot be written"):
        build_report([folder], tmp_path / "locked" / "report.pdf")


def test_an_output_below_a_file_is_refused_and_nothing_is_left(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    with pytest.raises(InvalidInput, match="cannot be written"):
        build_report([folder], tmp_path / "file" / "report.pdf")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def _test(**changes: float) -> pd.Series[float]:
    found = {"p_holm": 0.01, "p_sources": 0.04, "p_targets": 0.03, "effect": -0.9}
    return pd.Series(found | {"ratio": 0.5, "ratio_low": 0.4, "ratio_high": 0.6} | changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"p_holm": 0.06},
        {"p_sources": 0.06},
        {"p_targets": 0.06},
        {"ratio_high": 1.01},
        {"p_targets": np.nan},
        {"ratio_low": np.nan, "ratio_high": np.nan},
        {"effect": 0.9},
    ],
)
def test_a_claim_needs_all_analyses_in_one_direction(changes: dict[str, float]) -> None:
    assert supported(_test())
    assert supported(_test(ratio=2.0, ratio_low=1.5, ratio_high=2.5, effect=0.9))
    assert not supported(_test(**changes))


def test_claims_are_made_with_enough_people_and_only_then(tmp_path: Path) -> None:
    for people, claimed in ((4, False), (7, True)):
        (study,) = load([write_example_study(tmp_path / str(people), people, draws=1, failures=False)])
        tests = paired_tests(study.metrics, "plbs", FAMILY)
        text = " ".join(findings(study, tests))
        assert ("Error larger than that of plbs, ratio [95 % interval]: delta " in text) == claimed
        assert ("no difference can be claimed" in text) != claimed
        assert ("Each claim holds by itself at about 5 %" in text) == claimed
        assert "= <" not in text


def test_the_best_mean_of_a_control_is_marked(folder: Path) -> None:
    (study,) = load([folder])
    assert (
        "the smallest mean error is that of plbs residual (control),"
        in findings(study, paired_tests(study.metrics, "plbs", FAMILY))[0]
    )


def test_bold_needs_people_enough_for_a_claim(tmp_path: Path) -> None:
    for people, bold in ((4, False), (7, True)):
        (study,) = load([write_example_study(tmp_path / str(people), people, draws=1, failures=False)])
        tests = paired_tests(study.metrics, "plbs", FAMILY)
        rows = rows_of_tests(study, tests.assign(adjusted=tests["p_holm"]))
        assert (tests["p_holm"] < 0.05).any()
        assert any(row["strong"] for row in rows) == bold
        (study,) = load([tmp_path / str(people)])
        assert all(row["strong"] for row in rows_of_tests(study, tests.assign(adjusted=0.01))) == bold
        assert not any(row["strong"] for row in rows_of_tests(study, tests.assign(adjusted=0.06)))
        check = replace(study, facts=study.facts | {"dataset": study.facts["dataset"] | {"truth": "additive"}})
        assert not any(row["strong"] for row in rows_of_tests(check, tests.assign(adjusted=0.01)))


def test_every_measure_is_printed_once_where_it_fits(folder: Path) -> None:
    (study,) = load([folder])
    table = every_measure(study)
    assert table is not None
    assert table["count"] == 30
    assert [(row["measure"], row["region"]) for row in table["rows"]] == [
        (metric, region)
        for metric in ("vertex_l2_mean", "vertex_l2_max")
        for region in ("head", "lips", "brows", "jaw_skin")
    ]
    mean = study.at("vertex_l2_max", "lips").set_index(["method", "n_examples"]).loc[("delta", 30), "mean"]
    row = next(row for row in table["rows"] if (row["measure"], row["region"]) == ("vertex_l2_max", "lips"))
    assert float(row["cells"][table["labels"].index("delta")]) == pytest.approx(mean, abs=5e-3)
    assert "n/a" in row["cells"]  # what served no pair
    assert every_measure(study, (7, 16)) is None
    assert every_measure(study, (64, 3)) is None


def test_no_mean_of_a_signed_measure_is_the_best(folder: Path) -> None:
    (study,) = load([folder])
    rows = summary_rows(study, "vertex_l2_mean", "head")
    assert sum(cell["best"] for row in rows for cell in row["cells"]) == 3  # one at each number of examples
    signed = replace(study, summary=study.summary.assign(mean=study.summary["mean"] - 0.05))
    means = signed.at("vertex_l2_mean", "head").query("method == 'plbs_residual'")["mean"]
    assert (means < 0).any()
    rows = summary_rows(signed, "vertex_l2_mean", "head")
    best = [any(row["cells"][i]["best"] for row in rows) for i in range(3)]
    tested = signed.at("vertex_l2_mean", "head").query("method in @signed.tested")
    below = tested.groupby("n_examples")["mean"].min() < 0
    assert best == (~below).tolist()


def test_bold_regions_survive_the_correction(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of p = 0.01, 0.04, 0.045 and 0.9 only the first stays below 5 % after Benjamini-Hochberg: 0.04 becomes 0.06."""
    found = [("lbs", 5, "head", 0.01), ("lbs", 5, "lips", 0.04), ("delta", 5, "head", 0.045), ("delta", 5, "lips", 0.9)]
    table = pd.DataFrame(found, columns=["method", "n_examples", "region", "p"])
    monkeypatch.setattr(report, "region_tests", lambda *_: table)
    (study,) = load([folder])
    different = report._different_regions(study)
    assert different == {5: {("lbs", "head")}}
    regions, rows = region_rows(study, 5, different[5])
    bold = {(row["label"], r) for row in rows for r, c in zip(regions, row["cells"], strict=True) if c["strong"]}
    assert bold == {("lbs", "head")}


def test_a_family_that_was_not_run_whole_is_called_incomplete(tmp_path: Path) -> None:
    folder = write_example_study(tmp_path / "study", identities=2, draws=1, failures=False)
    for frames in folder.glob("*/frames.npz"):
        frames.unlink()
    facts = json.loads((folder / "study.json").read_text())
    facts["primary_family"] += ["a_method_that_was_left_out", "neutral"]
    facts["dataset"]["favours"] = ""
    facts["primary_metric"] = "vertex_l2_max"
    (folder / "study.json").write_text(json.dumps(facts))
    text = " ".join(_pages(build_report([folder])))
    assert "Family incomplete: 9 of 12 tests." in text
    assert "[–]" in text
    assert "[n/a" not in text
    assert "The error of an expression on a region is vertex_l2_max in mm." in text


def test_ticks_of_a_narrow_axis_do_not_touch() -> None:
    few = figures._log_steps(0.01, 200, points=110, apart=24)
    assert few == pytest.approx([0.01, 0.1, 1, 10, 100])
    assert figures._log_steps(0.5, 2, points=110, apart=24) == [0.5, 1, 2]
    for low in (0.01, 0.3, 0.9):
        ticks = np.log10(figures._log_steps(low, 200, points=110, apart=24))
        assert len(ticks) >= 2
        assert np.diff(ticks).min() * 110 / np.log10(200 / low) >= 24


def _bare(folder: Path, **facts: object) -> Path:
    """An example study of three people without frames, with some entries of study.json set."""
    write_example_study(folder, identities=3, draws=1, failures=False)
    (folder / "study.json").write_text(json.dumps(json.loads((folder / "study.json").read_text()) | facts))
    return folder


def test_measures_tables_and_solves_are_printed(tmp_path: Path) -> None:
    measures = {"delta": [["vertex_l2_max", "lips"]], "lbs": [["never_taken", "lips"]]}
    folder = _bare(tmp_path / "study", tables=[["vertex_l2_max", "lips"], ["never_taken", "lips"]], measures=measures)
    cells = pd.read_parquet(folder / "cells.parquet")
    late = (cells["method"] == "plbs") & (cells["n_examples"] == 5)
    counts = {"solves": 5, "solves_not_converged": np.where(late, 2, 0), "solves_failed": 0}
    cells.assign(**counts).to_parquet(folder / "cells.parquet")
    (study,) = load([folder])
    rows = measure_rows(study, seed=0)
    assert [(row["label"], row["count"], row["measure"]) for row in rows] == [
        ("delta", count, "vertex_l2_max, lips, mm") for count in (5, 15, 30)
    ]
    means = study.at("vertex_l2_max", "lips").set_index(["method", "n_examples"])
    assert rows[0]["mean"] == f"{means.loc[('delta', 5), 'mean']:.3f}"
    assert rows[0]["reference"] == f"{means.loc[('plbs', 5), 'mean']:.3f}"
    assert rows[0]["ratio"] == f"{means.loc[('delta', 5), 'ratio']:.2f}"
    assert solve_rows(study) == [{"label": "plbs", "count": 5, "solves": 30, "late": 12, "failed": 0}]
    text = " ".join(_pages(build_report([folder])))
    for words in (
        "What each row was meant to change",
        "vertex_l2_max on region lips in mm",
        "stopped at their iteration",
    ):
        assert words in text, words
    assert "never_taken" not in text


def test_correspondences_of_one_study_stand_side_by_side(tmp_path: Path) -> None:
    folder = _bare(tmp_path / "study")
    for name, key in (("metrics.parquet", "value"), ("cells.parquet", None), ("summary.csv", "mean")):
        read, path = (pd.read_csv if name.endswith("csv") else pd.read_parquet), folder / name
        given = read(path)
        worse = given.assign(correspondence="embedded", **({key: 2 * given[key]} if key else {}))
        both = pd.concat([given, worse], ignore_index=True)
        both.to_csv(path, index=False) if name.endswith("csv") else both.to_parquet(path)
    given, embedded = load([folder])
    assert [study.differs for study in (given, embedded)] == ["correspondence=given", "correspondence=embedded"]
    assert set(embedded.cells["correspondence"]) == set(embedded.metrics["correspondence"]) == {"embedded"}
    rows = correspondence_rows([given, embedded], seed=0)
    assert {row["ratio"] for row in rows} == {"2.00"}
    assert {row["method"] for row in rows} == {given.label(name) for name in given.tested}
    assert correspondence_rows([given], seed=0) == []
    text = " ".join(_pages(build_report([folder])))
    assert "Other source examples against given ones" in text
    assert "Conditions side by side" in text


def test_the_parts_of_a_method_get_pages(tmp_path: Path) -> None:
    folder = _bare(tmp_path / "study", parts="plbs_residual")
    for path in folder.glob("plbs_residual-*/frames.npz"):
        arrays = dict(np.load(path))
        moved = arrays["truth"] - arrays["target_neutral"]
        parts = {"part_plbs": arrays["truth"] + 1.0, "part_missing_target": moved, "part_unknown": moved}
        np.savez_compressed(path, **arrays, **parts)
    (study,) = load([folder])
    pages = heads.render_heads(study, tmp_path, "p")
    assert pages is not None
    assert [page.n_examples for page in pages.parts] == [5, 15, 30]
    shown = pages.parts[0].rows[0].heads
    assert [head.label for head in shown] == ["source", "patchwise blendshapes", "missing, target", "result", "truth"]
    assert [head.caption for head in shown[:3]] == ["", "1.73 mm", ""]
    assert all((tmp_path / str(head.image)).exists() for head in shown)
    assert "Parts of plbs residual: 5 examples" in " ".join(_pages(build_report([folder])))


def test_another_kind_of_study_is_a_part_of_the_document(folder: Path, tmp_path: Path) -> None:
    runtime = tmp_path / "runtime"
    runtime.mkdir()
    for name in ("frames.csv", "method.csv"):
        (runtime / name).write_text("a\n1\n")
    (runtime / "summary.csv").write_text(
        "surface,expressions,expressions_per_s,expressions_per_s_collisions,setup_seconds,template\n"
        "soft,60,11.5,2.0,3.0,paper\n"
    )
    gathered = gather([folder, runtime])
    assert [len(group) for group in gathered.groups] == [1]
    assert list(gathered.tables["runtime"]) == ["runtime"]
    content = describe(gathered, _work(tmp_path), lambda line: None)
    assert [sheet["study"] for sheet in content["sheets"]] == ["runtime"]
    assert ("expressions per second", "10", "11.5") in content["sheets"][0]["blocks"][0]["rows"]
    shown = {claim["says"]: claim["status"] for claim in content["claims"]["shown"]}
    assert shown["About 10 expressions per second without resolving collisions."] == "reproduced"
    text = " ".join(_pages_of(typeset(content, tmp_path / "work")))
    assert "Expressions per second" in text
    assert "Threadripper" in text


def test_a_study_of_one_method_and_one_pair_says_that_nothing_is_testable(tmp_path: Path) -> None:
    folder = write_example_study(tmp_path / "one", identities=2, draws=1, failures=False)
    for name in ("metrics.parquet", "cells.parquet"):
        table = pd.read_parquet(folder / name)
        alone = (table["method"] == "plbs") & (table["source"] == "person_00")
        table[alone].to_parquet(folder / name)
    summary = pd.read_csv(folder / "summary.csv")
    summary[summary["method"] == "plbs"].to_csv(folder / "summary.csv", index=False)
    facts = json.loads((folder / "study.json").read_text())
    facts["methods"] = [method for method in facts["methods"] if method["name"] == "plbs"]
    (folder / "study.json").write_text(json.dumps(facts))
    for frames in folder.glob("*/frames.npz"):
        frames.unlink()
    text = " ".join(_pages(build_report([folder])))
    assert "nothing is testable" in text
    assert "No method of the primary family could be compared." in text


def test_folders_without_results_or_with_broken_sheets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="expected a results folder"):
        gather([tmp_path])
    sheet = tmp_path / "study" / "page.sheet"
    sheet.mkdir(parents=True)
    for text, words in (("{", "expected the content"), ('{"schema": 9}', "schema 9"), ('{"schema": 1}', "blocks")):
        (sheet / "content.json").write_text(text)
        with pytest.raises(InvalidInput, match=words):
            gather([tmp_path])
    block = {"kind": "grid", "rows": [{"pictures": [{"file": "gone.jpg"}]}]}
    (sheet / "content.json").write_text(json.dumps({"schema": 1, "blocks": [block]}))
    with pytest.raises(InvalidInput, match=r"gone.jpg.*missing"):
        gather([tmp_path])


def test_conditions_share_one_scale_of_errors(tmp_path: Path) -> None:
    for name, noise in (("0", 0.0), ("1", 3.0)):
        write_example_study(tmp_path / name, identities=2, draws=1, noise_mm=noise, failures=False)
    gathered = gather([tmp_path / "0", tmp_path / "1"])
    alone = [heads.error_limit([study]) for study in gathered.groups[0]]
    assert alone[0] < alone[1]
    (chapter,) = describe(gathered, _work(tmp_path), lambda line: None)["chapters"]
    limits = {study["heads"]["limit_mm"] for study in chapter["studies"]}
    assert limits == {heads.error_limit(gathered.groups[0])}
    assert alone[0] <= limits.pop() <= alone[1]
