"""The questionnaire: balanced, repeatable, the key apart, and nothing in it that names a method."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pypdf import PdfReader

from reports import questionnaire_form
from reports.load import StudyResults, load
from reports.questionnaire import Design, Questionnaire, questionnaire, read_key, write_key
from reports.questionnaire_form import write_form
from reports.rankings import read_rankings
from retarget.check import InvalidInput
from tests.reports.example_study import COUNTS, write_example_study

METHODS = ["plbs", "lbs", "delta", "plbs_residual"]
CONFIG: dict[str, Any] = {
    "name": "peers",
    "question": 'Rank <b>these</b> & "those".',
    "methods": METHODS,
    "reference": "plbs",
    "target_example": "similar",
    "n_examples": None,
    "items": 5,
    "distinct": False,
    "seed": 0,
}
DESIGN = Design.from_config(CONFIG)
SIZE = (30, 40)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    folder = write_example_study(tmp_path_factory.mktemp("study"), identities=3, draws=1, failures=False)
    return load([folder])[0]


@pytest.fixture(scope="module")
def made(study: StudyResults) -> Questionnaire:
    return questionnaire(study, DESIGN)


@pytest.fixture(scope="module")
def form(made: Questionnaire, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(questionnaire_form.os, "cpu_count", lambda: 1)  # no processes for pictures of 30 x 40 pixels
        return write_form(made, tmp_path_factory.mktemp("form"), SIZE)


def test_without_a_number_there_are_as_many_items_as_the_kept_frames_allow(study: StudyResults) -> None:
    """One pair was kept, with 5 expressions, and each is asked about once: 3 example counts share them."""
    asked = Design.from_config(CONFIG | {"items": None, "distinct": True})
    fitted = questionnaire(study, asked)
    assert len(fitted.shown) == 3
    assert "1 for each of 5, 15 and 30 examples instead of 5" in fitted.sparse
    assert "the frames of 1 of 6 pairs" in fitted.sparse
    assert "study.figures.pairs=6" in fitted.sparse
    assert fitted.key == questionnaire(study, replace(asked, items=1)).key
    enough = questionnaire(study, replace(asked, distinct=False))
    assert len(enough.shown) == 15
    assert enough.sparse == ""
    with pytest.raises(InvalidInput, match="expected 2 expressions for each"):
        questionnaire(study, replace(asked, items=2))


def test_items_are_balanced_over_counts_and_letters_over_places(made: Questionnaire) -> None:
    items = made.key.items
    assert [item.number for item in items] == list(range(1, 16))
    assert Counter(item.n_examples for item in items) == dict.fromkeys(COUNTS, 5)
    assert all(list(item.letters) == list("ABCD") and set(item.letters.values()) == set(METHODS) for item in items)
    for method in METHODS:
        places = Counter(letter for item in items for letter, m in item.letters.items() if m == method)
        assert set(places.values()) <= {3, 4}
    assert len({tuple(item.letters.values()) for item in items}) > 4
    at = [(item.n_examples, item.expression) for item in items]
    assert len(set(at)) == len(at)
    assert [item.n_examples for item in items] != sorted(item.n_examples for item in items)


def test_pictures_are_what_the_key_says(made: Questionnaire, study: StudyResults) -> None:
    for shown in made.shown:
        item = shown.item
        for letter, method in item.letters.items():
            [cell] = [c for c in study.figure_cells if (c.method, c.n_examples) == (method, item.n_examples)]
            t = cell.frames.expressions.index(item.expression)
            assert np.array_equal(shown.results[letter], cell.frames.retargeted[t])
            assert item.vertex_error_mm[method] == pytest.approx(np.nanmean(cell.frames.error(t)), abs=1e-6)
            assert np.array_equal(shown.source, cell.frames.source[t])


def test_a_similar_example_is_the_nearest_other_expression_of_the_target(made: Questionnaire) -> None:
    for shown in made.shown:
        frames, t = shown.frames, shown.frames.expressions.index(shown.item.expression)
        distances = np.linalg.norm((frames.truth - frames.truth[t])[:, frames.head], axis=2).mean(axis=1)
        distances[t] = np.inf
        assert shown.item.example.expression == frames.expressions[int(distances.argmin())]
        assert shown.example is not None
        assert np.array_equal(shown.example, frames.truth[int(distances.argmin())])


@pytest.mark.parametrize("kind", ["none", "neutral", "truth"])
def test_other_examples(study: StudyResults, kind: str) -> None:
    shown = questionnaire(study, replace(DESIGN, target_example=kind)).shown[0]
    t = shown.frames.expressions.index(shown.item.expression)
    wanted = {"none": None, "neutral": shown.frames.target_neutral, "truth": shown.frames.truth[t]}[kind]
    assert (shown.example is None) if wanted is None else np.array_equal(shown.example, wanted)  # type: ignore[arg-type]


def test_the_same_seed_gives_the_same_and_another_another(made: Questionnaire, study: StudyResults) -> None:
    assert questionnaire(study, DESIGN).key == made.key
    other = questionnaire(study, replace(DESIGN, seed=1)).key
    assert other.id != made.key.id
    assert [item.letters for item in other.items] != [item.letters for item in made.key.items]


def test_an_expression_is_asked_about_once_where_enough_were_kept(study: StudyResults) -> None:
    items = questionnaire(study, replace(DESIGN, items=1, distinct=True)).key.items
    assert len({item.expression for item in items}) == 3


def test_too_few_kept_frames_are_refused_with_the_setting_that_keeps_more(study: StudyResults) -> None:
    with pytest.raises(
        InvalidInput, match=r"15 different ones.* has 5 expressions of 1 of 6 pairs, and 5 at .* study.figures.pairs=6"
    ):
        questionnaire(study, replace(DESIGN, distinct=True))
    with pytest.raises(InvalidInput, match=r"study\.figures\.pairs"):
        questionnaire(study, replace(DESIGN, items=6))


def test_without_any_frames_the_setting_that_keeps_them_is_named(study: StudyResults, tmp_path: Path) -> None:
    bare = replace(study, folder=tmp_path)
    with pytest.raises(
        InvalidInput, match=r"has none of them\. Run the study again with study\.figures\.pairs=2"
    ) as no:
        questionnaire(bare, DESIGN)
    assert "0 of" not in str(no.value)
    some = [cell for cell in study.figure_cells if cell.method == DESIGN.methods[0]]
    for cell in some:
        there = tmp_path / cell.path.relative_to(study.folder)
        there.parent.mkdir()
        there.write_bytes(cell.path.read_bytes())
    with pytest.raises(InvalidInput, match=f"has only those of {DESIGN.methods[0]}"):
        questionnaire(replace(study, folder=tmp_path, differs="again"), DESIGN)


def test_pairs_are_balanced(tmp_path: Path) -> None:
    """Frames of a second pair: each count takes from both pairs, as evenly as its number allows."""
    folder = write_example_study(tmp_path, identities=3, draws=1, failures=False)
    for kept in sorted(folder.glob("*/frames.npz")):
        copied = folder / kept.parent.name.replace("person_00-person_01", "person_01-person_00")
        copied.mkdir()
        with np.load(kept) as archive:
            np.savez(copied / "frames.npz", **archive)
    study = load([folder])[0]
    for seed in range(6):
        items = questionnaire(study, replace(DESIGN, items=3, distinct=True, seed=seed)).key.items
        for count in COUNTS:
            pairs = Counter((item.source, item.target) for item in items if item.n_examples == count)
            assert sorted(pairs.values()) == [1, 2]
        assert sorted(Counter(item.source for item in items).values()) == [4, 5]
        assert max(Counter(item.expression for item in items).values()) <= 2


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"methods": ["plbs", "anacondar"]},
            "the study 'example' has no row 'anacondar', it has .*'method=.plbs,anaco",
        ),
        ({"methods": ["plbs", "neutral"]}, "has no row 'neutral'"),
        ({"methods": ["plbs"]}, "expected 2 to 8 different rows"),
        ({"methods": ["plbs", "plbs"]}, "expected 2 to 8 different rows"),
        ({"methods": "plbs"}, "expected 2 to 8 different rows"),
        ({"reference": "delta2"}, "questionnaire.reference: 'delta2' is unknown.*Did you mean 'delta'"),
        ({"target_example": "real"}, "questionnaire.target_example: 'real' is unknown"),
        ({"items": 0}, "questionnaire.items: expected a whole number of at least 1, got 0"),
        ({"items": True}, "questionnaire.items"),
        ({"seed": -1}, "questionnaire.seed"),
        ({"n_examples": [7]}, "questionnaire.n_examples: '7' is unknown, expected one of 5, 15, 30"),
    ],
)
def test_settings_that_no_questionnaire_can_have_are_refused(
    study: StudyResults, change: dict[str, Any], said: str
) -> None:
    with pytest.raises(InvalidInput, match=said):
        questionnaire(study, Design.from_config(CONFIG | change))


def test_a_key_is_read_back_and_never_replaced_by_another(made: Questionnaire, tmp_path: Path) -> None:
    path = tmp_path / "key.json"
    write_key(path, made.key)
    assert read_key(path) == made.key
    before = path.read_bytes()
    write_key(path, made.key)
    with pytest.raises(InvalidInput, match="key of another questionnaire"):
        write_key(path, replace(made.key, id="0123456789ab"))
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "cannot be read as one"),
        ("[]", "cannot be read as one"),
        ('{"schema": 1, "items": []}', "cannot be read as one"),
        ('{"schema": 1, "items": [{"number": 1}]}', "cannot be read as one"),
        (None, "there is no such key"),
    ],
)
def test_a_file_that_is_no_key_is_refused(tmp_path: Path, text: str | None, said: str) -> None:
    path = tmp_path / "key.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InvalidInput, match=said):
        read_key(path)


def test_a_key_with_letters_exchanged_is_refused(made: Questionnaire, tmp_path: Path) -> None:
    path = tmp_path / "key.json"
    write_key(path, made.key)
    content = json.loads(path.read_text())
    letters = content["items"][0]["letters"]
    letters["A"], letters["B"] = letters["B"], letters["A"]
    path.write_text(json.dumps(content))
    with pytest.raises(InvalidInput, match="was changed after it was written"):
        read_key(path)
    path.write_text(json.dumps(content | {"schema": 2}))
    with pytest.raises(InvalidInput, match="schema 2"):
        read_key(path)


class _Page(HTMLParser):
    """What a page shows and what it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def test_the_page_holds_all_items_and_loads_nothing(form: tuple[Path, Path], made: Questionnaire) -> None:
    text = form[0].read_text(encoding="utf-8")
    page = _Page(text)
    assert len(page.all("section")) == 15
    images = page.all("img")
    assert len(images) == 15 * (2 + len(METHODS))
    for image in images:
        data = str(image["src"])
        assert data.startswith("data:image/jpeg;base64,")
        assert Image.open(io.BytesIO(base64.b64decode(data.split(",", 1)[1]))).size == SIZE
    assert len([button for button in page.all("input") if button["type"] == "radio"]) == 15 * 4 * 4
    assert not page.all("link")
    assert not [script for script in page.all("script") if "src" in script]
    assert "://" not in text
    assert "default-src 'none'" in text
    assert "Rank &lt;b&gt;these&lt;/b&gt; &amp; &quot;those&quot;." in text
    assert "<b>these" not in text


def test_neither_form_tells_what_a_rater_must_not_know(form: tuple[Path, Path], made: Questionnaire) -> None:
    page = re.sub(r"base64,[^\"]*", "", form[0].read_text(encoding="utf-8"))
    paper = PdfReader(io.BytesIO(form[1].read_bytes()))
    printed = " ".join(p.extract_text() for p in paper.pages) + str(paper.metadata)
    for text in (page, printed):
        for secret in (*METHODS, "anacondar", "person_", "expression_", made.key.title, "example study", " mm"):
            assert secret not in text, secret
        assert made.key.id in text
    assert {path.name for path in form[0].parent.iterdir()} == {"questionnaire.html", "questionnaire.pdf"}


def test_the_paper_holds_the_same_items(form: tuple[Path, Path]) -> None:
    pages = PdfReader(io.BytesIO(form[1].read_bytes())).pages
    assert len(pages) == 8  # two items each
    assert all(5 < len(page.images) <= 2 * (2 + len(METHODS)) for page in pages)  # equal pictures are stored once
    words = " ".join(page.extract_text() for page in pages).split()
    assert all(words.count(word) == 15 for word in ("Source", "B", "C", "D"))


def test_the_same_questionnaire_gives_the_same_bytes(
    form: tuple[Path, Path], made: Questionnaire, tmp_path: Path
) -> None:
    """Also where several processes take the pictures."""
    again = write_form(made, tmp_path, SIZE)
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in form]


DRIVER = """
const fs = require("fs"), vm = require("vm");
const page = fs.readFileSync(process.argv[2], "utf8");
const scripts = [...page.matchAll(/<script[^>]*>([^]*?)<\\/script>/g)].map((m) => m[1]);
function element(more) {
  const names = new Set(), heard = {};
  return Object.assign({ value: "", textContent: "", focus() {}, scrollIntoView() {}, click() {},
    classList: { add: (n) => names.add(n), remove: (n) => names.delete(n),
                 toggle: (n, on) => on ? names.add(n) : names.delete(n), contains: (n) => names.has(n) },
    addEventListener: (name, f) => { heard[name] = f; }, fire: (name) => heard[name]() }, more);
}
const ids = {};
for (const id of ["participant", "said", "progress", "save", "clear"]) ids[id] = element({});
ids.facts = element({ textContent: scripts[0] });
const sections = [...page.matchAll(/<section data-item="(\\d+)">([^]*?)<\\/section>/g)].map((m) => {
  const radios = [...m[2].matchAll(/<input type="radio" name="([^"]+)" value="(\\d+)" data-letter="(\\w+)"/g)]
    .map((r) => element({ name: r[1], value: r[2], checked: false, dataset: { letter: r[3] } }));
  return element({ dataset: { item: m[1] }, querySelectorAll: () => radios, radios });
});
const kept = {}, blobs = [];
const world = {
  document: { getElementById: (id) => ids[id], querySelectorAll: () => sections, createElement: () => element({}) },
  localStorage: { getItem: (k) => kept[k] === undefined ? null : kept[k], setItem: (k, v) => { kept[k] = v; } },
  Blob: function (parts) { blobs.push(parts.join("")); }, URL: { createObjectURL: () => "blob:" },
  confirm: () => true };
vm.runInNewContext(scripts[1], world);
function press(section, letter, rank) {
  const radio = section.radios.find((r) => r.dataset.letter === letter && r.value === String(rank));
  for (const other of section.radios) if (other.name === radio.name) other.checked = false;
  radio.checked = true;
  radio.fire("change");
}
const said = [];
function save() { ids.save.fire("click"); said.push(ids.said.textContent); }
save();
ids.participant.value = "=1+1"; save();
ids.participant.value = "p01"; save();
sections.forEach((s, i) => {
  for (const [j, letter] of ["A", "B", "C", "D"].entries()) press(s, letter, (i + j) % 4 + 1);
});
press(sections[0], "A", 2);
save();
press(sections[0], "B", 1);
const asked = sections[1].classList.contains("ranked") && ids.progress.textContent;
save();
ids.clear.fire("click");
console.log(JSON.stringify({ said, blobs, asked, after: ids.progress.textContent, kept: Object.values(kept) }));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="no node on PATH to run the page's script")
def test_the_page_saves_what_was_chosen_and_it_can_be_read(
    form: tuple[Path, Path], made: Questionnaire, tmp_path: Path
) -> None:
    """The page's own script with a document of the barest kind: a rater clicks through it."""
    (tmp_path / "driver.js").write_text(DRIVER)
    ran = subprocess.run(
        ["node", str(tmp_path / "driver.js"), str(form[0])], capture_output=True, text=True, timeout=60, check=True
    )
    found = json.loads(ran.stdout)
    assert found["said"][0].startswith("Enter your participant code")
    assert found["said"][1].startswith("Enter your participant code")
    assert found["said"][2] == "Number 1 is not ranked yet."
    assert found["said"][3] == "Number 1 is not ranked yet."  # rank 2 went from B to A, so B has none
    assert found["said"][4] == "Saved as rankings_p01.csv."
    assert found["asked"] == "15 of 15 ranked"
    assert found["after"] == "0 of 15 ranked"
    [text] = found["blobs"]
    (tmp_path / "rankings_p01.csv").write_bytes(text.encode())
    ranks = read_rankings([tmp_path / "rankings_p01.csv"], made.key)
    assert ranks.raters == "human"
    first = ranks.ranks[ranks.ranks["item"] == 1].set_index("method")["rank"]
    letters = made.key.items[0].letters
    assert {letter: first[method] for letter, method in letters.items()} == {"A": 2, "B": 1, "C": 3, "D": 4}
