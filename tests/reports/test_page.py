"""The page: its tables are those of the PDF, its meshes those of the kept frames, and nothing from outside runs."""

from __future__ import annotations

import base64
import copy
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_hex

from reports import heads
from reports.colors import ERROR_COLORMAP, method_color
from reports.folders import Gathered
from reports.load import StudyResults, load
from reports.page import page, write_page
from reports.page_heads import STEP, Walk, pack, pack_heads
from reports.report import alone, build_report, describe
from reports.text import number
from retarget.check import InvalidInput
from tests.reports.example_study import ball, write_example_study
from tests.reports.page_reader import Meshes, Read, unpacked

PLOT = "data:image/svg+xml;base64,"
MARKUP = "</script><img src=x onerror=alert(1)>&'\""


def content_of(studies: tuple[StudyResults, ...], work: Path) -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(heads, "SIZE", (11, 14))
        gathered = Gathered(tuple(study.folder for study in studies), (studies,), ())
        return alone(describe(gathered, work, lambda line: None)["chapters"][0], studies)


@pytest.fixture(scope="module")
def studies(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResults, ...]:
    return load([write_example_study(tmp_path_factory.mktemp("study"), draws=1)])


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the plots are."""
    return tmp_path_factory.mktemp("work")


@pytest.fixture(scope="module")
def content(studies: tuple[StudyResults, ...], work: Path) -> dict[str, Any]:
    return content_of(studies, work)


def test_no_ratio_is_announced_where_there_is_none(
    content: dict[str, Any], studies: tuple[StudyResults, ...], work: Path
) -> None:
    """As where the reference has no result."""
    said = "and the geometric-mean ratio to plbs"
    assert said in page(content, studies, work)
    bare = copy.deepcopy(content)
    for row in bare["studies"][0]["summary"]:
        for cell in row["cells"]:
            cell["ratio"] = ""
    assert said not in page(bare, studies, work)


@pytest.fixture(scope="module")
def read(content: dict[str, Any], studies: tuple[StudyResults, ...], work: Path) -> Read:
    return Read(page(content, studies, work))


def test_the_tables_hold_the_summary(read: Read, studies: tuple[StudyResults, ...]) -> None:
    table = {row[0].split(" (")[0]: row for row in read.tables[0][2:]}
    shown = 0
    for row in studies[0].primary.itertuples():
        at = 1 + 3 * [5, 15, 30].index(row.n_examples)
        name = next(
            key for key in table if key.split(" no method")[0].split(" reference")[0] == studies[0].label(row.method)
        )
        mean, interval = table[name][at : at + 2]
        if np.isfinite(row.mean):
            assert mean.split()[0] == f"{row.mean:.3f}"
            assert interval == f"[{row.ci_low:.3f}, {row.ci_high:.3f}]"
            shown += 1
        else:
            assert mean == "no result 12 missing"
    assert shown == 20


def test_every_section_has_its_words(read: Read) -> None:
    for words in (
        "Quantitative comparison on synthesised ground truth",
        "favours linear methods",
        "plbs residual (control)",
        "neutral no method",
        "Family incomplete: 8 of 9 tests.",
        "LinAlgError: the matrix of patch 17 is singular",
        "needs fewer than 20 examples",
        "p targets",
        "02 January 2026",
        "patch_count = none",
        "numpy 2.4.6",
    ):
        assert words in read.words, words


def test_every_table_prints_what_the_pdf_prints(read: Read, content: dict[str, Any]) -> None:
    (study,) = content["studies"]
    cells = {cell.split(" ")[0] for table in read.tables for row in table for cell in row}
    for row in study["tests"] + study["secondary"]:
        assert {row["ratio"], row["p"].split(" ")[0], row["adjusted"].split(" ")[0]} <= cells
    for part in study["regions"]:
        assert {c["text"] for row in part["rows"] for c in row["cells"]} <= cells
    for row in study["times"]:
        assert row["frame"]["median"].split(" ")[0] in cells


def test_plots_are_those_of_the_pdf(read: Read, content: dict[str, Any], work: Path) -> None:
    (study,) = content["studies"]
    images = [attributes for tag, attributes in read.tags if tag == "img"]
    shown = [base64.b64decode(str(attributes["src"]).removeprefix(PLOT)) for attributes in images]
    assert shown == [(work / name).read_bytes() for name in (content["box"], study["examples"], study["ratio"])]
    assert all(picture.lstrip().startswith(b"<?xml") for picture in shown)
    assert all(str(attributes["alt"]).endswith(".") for attributes in images)


def test_claims_have_a_status_and_limits_are_told(read: Read, content: dict[str, Any]) -> None:
    claims = content["claims"]
    (table,) = (table for table in read.tables if table[0][:2] == ["claim", "section"])
    assert len(table) - 1 == len(claims["shown"]) > 0
    for row, claim in zip(table[1:], claims["shown"], strict=True):
        assert row[:4] == [claim["says"], claim["section"], ", ".join(map(str, claim["counts"])), "not testable"]
        assert "A claim needs at least 6 people" in row[-1]
    for claim in claims["untested"]:
        assert claim["says"] in read.words
    assert f"{claims['counts']['not testable']} not testable" in read.words
    for name, text in content["limits"]:
        assert f"{name} {text}".replace("`", "") in read.words
    links = [attributes.get("href") for tag, attributes in read.tags if tag == "a"]
    assert links[-2:] == ["#claims", "#limits"]


def test_meshes_are_the_kept_frames_to_the_stated_precision(read: Read, studies: tuple[StudyResults, ...]) -> None:
    (study,) = read.heads["studies"]
    (scene,) = study["scenes"]
    meshes = Meshes(read, study)
    cells = {(c.method, c.n_examples): c.frames for c in studies[0].figure_cells}
    frames = cells["plbs", 5]
    np.testing.assert_array_equal(meshes.indices("faces").reshape(-1, 3), frames.faces)
    np.testing.assert_array_equal(meshes.indices("head"), frames.head)
    source, target = meshes.frames(scene["neutrals"])
    half = STEP / 2 + 1e-4  # frames are single precision
    truth = target + meshes.frames(scene["truth"])
    for shown, kept in (
        (source, frames.source_neutral),
        (target, frames.target_neutral),
        (truth - target, frames.truth - frames.target_neutral),
        (meshes.frames(scene["motion"]), frames.source - frames.source_neutral),
    ):
        assert np.abs(shown - kept).max() <= half
    checked = 0
    for count, results in scene["results"].items():
        for method, result in results.items():
            mine, delta = cells[method, int(count)], meshes.frames(result["delta"])
            shown = np.linalg.norm(delta[:, mine.head], axis=2)
            kept = np.stack([mine.error(t)[mine.head] for t in range(len(delta))])
            assert np.abs(shown - kept).max() <= 0.01
            assert np.abs(truth + delta - mine.retargeted).max() <= 3 * half
            assert result["errors"] == [number(error, 2) for error in kept.mean(axis=1)]
            checked += 1
    assert checked == len(cells) == 20


def test_what_failed_is_missing_and_what_is_shown_first_includes_the_reference(read: Read) -> None:
    (study,) = read.heads["studies"]
    (scene,) = study["scenes"]
    assert "sumner_popovic" not in scene["results"]["30"]
    assert study["shown"] == ["delta", "sumner_popovic", "lbs", "plbs"]
    assert 1 <= scene["liveliest"] <= len(scene["expressions"]) == 5
    assert study["left_out"] == ""


def test_colours_and_scale_are_those_of_the_pdf(read: Read, content: dict[str, Any]) -> None:
    (study,) = read.heads["studies"]
    assert study["limit"] == content["studies"][0]["heads"]["limit_mm"]
    assert read.heads["colors"] == [to_hex(ERROR_COLORMAP(share)) for share in np.linspace(0, 1, 11)]
    assert study["methods"][1]["color"] == method_color(1)


def test_the_page_asks_for_nothing_from_outside(read: Read) -> None:
    for tag, attributes in read.tags:
        assert tag not in ("link", "iframe", "object", "embed", "base", "form")
        assert tag == "img" or "src" not in attributes
        assert str(attributes.get("src", PLOT)).startswith(PLOT)
        assert attributes.get("href", "#").startswith("#")
    policies = [a["content"] for _, a in read.tags if a.get("http-equiv") == "Content-Security-Policy"]
    assert policies
    assert str(policies[0]).startswith("default-src 'none'")
    script = read.scripts[""]
    assert not re.search(r"https?:|\bfetch\(|\bimport\b|XMLHttp|Worker\(|\beval\(|innerHTML", script)


def test_words_from_outside_stay_words(tmp_path: Path, read: Read) -> None:
    folder = write_example_study(tmp_path / "study", identities=2, draws=1, failures=False)
    facts = json.loads((folder / "study.json").read_text())
    facts |= {"title": MARKUP, "description": MARKUP}
    facts["dataset"] |= {"favours": MARKUP, "name": MARKUP}
    for method in facts["methods"]:
        method |= {"label": method["label"] + MARKUP, "description": MARKUP, "settings": {MARKUP: MARKUP}}
    (folder / "study.json").write_text(json.dumps(facts))
    for path in folder.glob("*/frames.npz"):
        arrays = dict(np.load(path))
        np.savez_compressed(path, **arrays | {"expressions": np.array([f"{MARKUP}{i}" for i in range(5)])})
    cells = pd.read_parquet(folder / "cells.parquet")
    cells.assign(status="not_converged", reason=MARKUP).to_parquet(folder / "cells.parquet")
    metrics = pd.read_parquet(folder / "metrics.parquet")
    metrics.assign(status="not_converged").to_parquet(folder / "metrics.parquet")
    studies = load([folder])
    content = content_of(studies, tmp_path)
    verdict = {"study": MARKUP, "status": "reproduced", "value": MARKUP, "sentence": MARKUP}
    claim = {"says": MARKUP, "section": MARKUP, "published": MARKUP, "compared": MARKUP, "counts": [5]}
    claims = [claim | {"status": "reproduced", "verdicts": [verdict]}]
    content |= {"claims": content["claims"] | {"several": True, "shown": claims, "untested": claims}}
    content |= {"limits": [(MARKUP, MARKUP)]}
    hostile = Read(page(content, studies, tmp_path))
    images = [attributes for tag, attributes in hostile.tags if tag == "img"]
    assert len(images) == 3
    assert all(set(attributes) == {"src", "alt"} for attributes in images)
    assert all(str(attributes["src"]).startswith(PLOT) for attributes in images)
    assert not [attributes for _, attributes in hostile.tags if "onerror" in attributes]
    assert {name for name in hostile.scripts if not name.startswith("array-")} == {"", "heads"}
    assert hostile.scripts[""] == read.scripts[""]
    assert hostile.words.count(MARKUP) > 30
    assert hostile.heads["studies"][0]["scenes"][0]["expressions"][0] == MARKUP + "0"


def test_the_same_results_give_the_same_bytes(
    content: dict[str, Any], studies: tuple[StudyResults, ...], work: Path, tmp_path: Path
) -> None:
    again = load([studies[0].folder])
    assert write_page(tmp_path / "one.html", content, studies, work).read_bytes() == page(content, again, work).encode()


def test_a_small_budget_keeps_the_first_pair_and_says_what_is_left_out(studies: tuple[StudyResults, ...]) -> None:
    whole = pack_heads(studies[0], 1.0)
    assert whole is not None
    size = sum(map(len, whole.arrays))
    part = pack_heads(studies[0], 1.0, first=7, budget=3 * size // 4)
    assert part is not None
    assert sum(map(len, part.arrays)) <= 3 * size // 4
    shown = part.facts["scenes"][0]["results"]
    assert len(shown["5"]) == 7
    assert len(shown.get("15", {})) < 7
    named = int(part.facts["left_out"].split(" of ")[0])
    assert named == 20 - sum(map(len, shown.values())) > 0
    assert "of 20 kept results had no room on this page: person_00 to person_01, 15 examples" in part.facts["left_out"]
    assert part.facts["order"] == 7


def test_a_study_without_frames_has_tables_and_says_so(tmp_path: Path) -> None:
    folder = write_example_study(tmp_path / "study", identities=2, draws=1, failures=False)
    for path in folder.glob("*/frames.npz"):
        path.unlink()
    studies = load([folder])
    read = Read(page(content_of(studies, tmp_path), studies, tmp_path))
    assert "This study kept no frames" in read.words
    assert "All 42 cells finished." in read.words
    assert read.heads["studies"] == []
    assert any(attributes.get("id") == "viewer" and "hidden" in attributes for _, attributes in read.tags)


def test_several_studies_share_one_page_and_its_room(tmp_path: Path) -> None:
    for name, noise in (("0", 0.0), ("1", 0.3)):
        write_example_study(tmp_path / name, identities=2, draws=1, noise_mm=noise, failures=False)
    studies = load([tmp_path])
    read = Read(page(content_of(studies, tmp_path), studies, tmp_path))
    assert [study["label"] for study in read.heads["studies"]] == ["dataset.noise_mm=0.0", "dataset.noise_mm=0.3"]
    assert "Conditions side by side" in read.words
    assert len([tag for tag, _ in read.tags if tag == "img"]) == 2 + 2 * 2  # the order, boxes, and two of each study
    first, second = (Meshes(read, study) for study in read.heads["studies"])
    assert second.study["order"] > first.study["order"]
    np.testing.assert_array_equal(first.order, second.order)
    ids = [attributes["id"] for _, attributes in read.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    links = {str(attributes["href"])[1:] for tag, attributes in read.tags if tag == "a"}
    assert links <= set(ids)


def test_the_page_lies_beside_the_pdf_and_never_in_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heads, "SIZE", (11, 14))
    folder = write_example_study(tmp_path / "study", identities=2, draws=1, failures=False)
    assert build_report([folder], tmp_path / "both.pdf") == tmp_path / "both.pdf"
    assert (tmp_path / "both.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    with pytest.raises(InvalidInput, match="the page is written beside it"):
        build_report([folder], tmp_path / "other.html")
    assert not (tmp_path / "other.html").exists()


@settings(deadline=None)
@given(st.lists(st.integers(-(1 << 29), 1 << 29)))
def test_integers_survive_packing(values: list[int]) -> None:
    np.testing.assert_array_equal(unpacked(pack(values)), np.array(values, dtype=np.int64))


def test_a_result_that_flew_away_is_refused() -> None:
    with pytest.raises(InvalidInput, match="is no head"):
        pack([1 << 30])


@settings(deadline=None)
@given(st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_a_walk_reaches_every_vertex_after_its_neighbour(pieces: int, seed: int) -> None:
    """Also of a mesh in pieces, and with vertices that no triangle uses."""
    rng = np.random.default_rng(seed)
    faces = np.concatenate([ball(0)[1] + 13 * i for i in range(pieces)])
    count = 13 * pieces
    names = rng.permutation(count)
    walk = Walk.over(names[faces], count)
    assert sorted(walk.order) == list(range(count))
    assert walk.order[0] == 0
    assert (walk.before[1:] < np.arange(1, count)).all()
    values = rng.integers(-1000, 1000, (2, count, 3))
    steps, back = walk.steps(values), np.zeros_like(values)
    for i in range(count):
        back[:, walk.order[i]] = steps[:, i] + (back[:, walk.order[walk.before[i]]] if i else 0)
    np.testing.assert_array_equal(back, values)
