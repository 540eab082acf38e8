"""The command: from a finished study to the form and its key, and from returned files to the report."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from experiments.catalogue import composed, options
from experiments.overrides import check_overrides
from experiments.survey import survey
from reports.questionnaire import Design, read_key
from retarget.check import InvalidInput
from tests.reports.example_study import write_example_study
from tests.reports.raters import rank, write

SMALL = ["questionnaire.methods=[plbs,lbs]", "questionnaire.reference=plbs", "questionnaire.items=1", "width=50"]


def call(results: Path, *overrides: str) -> str:
    said = Console(file=io.StringIO(), width=200)
    survey(composed("survey", [*SMALL, *overrides]), results, said)
    return str(said.file.getvalue())  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_example_study(tmp_path_factory.mktemp("study"), identities=2, draws=1, failures=False)


def test_a_questionnaire_is_made_and_its_rankings_analysed(results: Path, tmp_path: Path) -> None:
    said = call(results)
    folder = results / "survey_peers"
    assert {path.name for path in (folder / "for_raters").iterdir()} == {"questionnaire.html", "questionnaire.pdf"}
    assert str(folder / "key.json") in said
    assert "\n3 items\n" in said
    key = read_key(folder / "key.json")
    returned = write(tmp_path / "returned.csv", rank(key, (1.0, 0.0), 3, seed=0))
    call(results, f"rankings={returned}", f"output={tmp_path / 'analysis'}", f"key={folder / 'key.json'}")
    assert (tmp_path / "analysis" / "synthetic_rankings.pdf").exists()
    call(results, f"rankings=[{returned}]")
    assert (folder / "synthetic_rankings.pdf").exists()
    assert not list(folder.glob("human*"))
    with pytest.raises(InvalidInput, match="key of another questionnaire"):
        call(results, "questionnaire.seed=1")
    assert read_key(folder / "key.json") == key


def test_without_rankings_or_results_nothing_is_written(results: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="there is no such key"):
        call(tmp_path, "rankings=none.csv")
    with pytest.raises(InvalidInput, match=r"study\.json"):
        call(tmp_path)
    with pytest.raises(InvalidInput, match="width: expected"):
        call(results, "width=9")
    with pytest.raises(InvalidInput, match="correspondence: 'ebfr' is unknown"):
        call(results, "correspondence=ebfr")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "study"), [("peers", None), ("parts", "ablation")])
def test_the_shipped_questionnaires_ask_about_methods_that_exist(name: str, study: str | None) -> None:
    config = composed("survey", [f"questionnaire={name}"]).questionnaire
    methods = list(config.methods)
    assert set(methods) <= set(options("method"))
    assert config.reference in methods
    assert config.name == name
    assert set(config) == set(Design.__dataclass_fields__)
    if study is not None:
        assert set(methods) <= set(composed("run", [f"study={study}"]).method)


def test_a_misspelt_questionnaire_is_refused_with_the_nearest() -> None:
    check_overrides("survey", ["study=ablation", "questionnaire=parts", "questionnaire.items=3", "ties=average"])
    with pytest.raises(InvalidInput, match="Did you mean 'peers'"):
        check_overrides("survey", ["questionnaire=peer"])
