"""The study `tuning`: its identities, its trials, its choice, and a small one from end to end."""

from __future__ import annotations

import io
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from rich.console import Console

from experiments import run as run_module
from experiments.catalogue import CONF, composed, make_method, method_settings, options
from experiments.identities import FIRST_TUNING_SEED, check_identities
from experiments.protocol import draw
from experiments.run import _plain, run
from experiments.tuning import Tuning, choice, row_name, trial_table
from retarget.check import InvalidInput
from retarget.types import Examples, Pair
from tests.experiments.toy import toy

SMALL = [
    "study=tuning",
    "backend=serial",
    "method=[delta,lbs_paper]",
    "study.trials=3",
    "scale.draws=1",
    "study.n_examples=[2,5]",
    "study.test_expressions=3",
    "~study.spaces.plbs",
    "~study.spaces.plbs_residual",
    "~study.spaces.lbs_residual",
    "~study.spaces.anacondar",
    "~study.spaces.adt",
    "~study.spaces.landmark_dt",
    "~study.spaces.ebfr",
    "~study.spaces.alm",
    "~study.variants.lbs_residual_uniform",
    "~study.variants.plbs_residual_uniform",
]


def configured(**changes: Any) -> Tuning:
    config = composed("run", ["study=tuning"])
    study = {name: value for name, value in _plain(config.study).items() if name != "kind"}
    return Tuning.from_config(study | changes, _plain(config.method))


@pytest.mark.parametrize("scale", options("scale"))
def test_identities_are_used_by_no_other_study(scale: str) -> None:
    seeds = {}
    for name in options("study"):
        dataset = composed("run", [f"study={name}", f"scale={scale}"]).dataset
        seeds[name] = set(range(dataset.first_seed, dataset.first_seed + dataset.identities))
    mine = seeds.pop("tuning")
    assert min(mine) == FIRST_TUNING_SEED
    for name, others in seeds.items():
        assert not mine & others, name
        assert max(others) < FIRST_TUNING_SEED, name


def test_tuning_and_studies_refuse_the_identities_of_one_another(tmp_path: Path) -> None:
    for study, seed in (("tuning", 998), ("ci", 998), ("noise", 1000), ("collision", 1004)):
        config = composed("run", [f"study={study}", f"dataset.first_seed={seed}", "scale.identities=4"])
        expected = "at least 1000 for tuning" if study == "tuning" else "identities below 1000"
        with pytest.raises(InvalidInput, match=rf"dataset\.first_seed: expected {expected}"):
            run(config, tmp_path, Console(file=io.StringIO()))
    assert not any(tmp_path.iterdir())
    check_identities({"first_seed": 1004, "identities": 4}, tuning=True)
    check_identities({"first_seed": 996, "identities": 4}, tuning=False)
    check_identities({"folder": "somebody's scans"}, tuning=True)


def test_every_method_gets_the_same_number_of_trials_and_its_present_configuration_first() -> None:
    tuning = configured()
    assert {len(trials) for trials in tuning.trials.values()} == {13}
    rows = {row.name: row for row in tuning.study.rows({})}
    for method, trials in tuning.trials.items():
        assert rows[row_name(method, 0)].settings == method_settings(method)
        settings = [tuple(rows[row_name(method, number)].settings.items()) for number in range(len(trials))]
        assert len(set(settings)) == 13


def test_every_method_with_a_tuned_and_a_printed_form_is_tuned() -> None:
    tunable = {name.removesuffix("_paper") for name in options("method") if name.endswith("_paper")}
    parts = {"alm_patch_only"}  # the first step of `alm`, with its settings
    assert tunable - parts <= set(configured().trials)


def test_the_present_configuration_is_that_of_a_chosen_method_where_it_was_changed() -> None:
    config = composed("run", ["study=tuning", "method=[lbs]", "method.lbs.lambda_reg=0.5"])
    study = {name: value for name, value in _plain(config.study).items() if name != "kind"}
    assert Tuning.from_config(study, _plain(config.method)).trials["lbs"][0].settings == {"lambda_reg": 0.5}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"trials": 0}, "study.trials: expected a whole number of at least 1, got 0"),
        ({"trials": True}, "study.trials"),
        ({"spaces": {}}, "study.spaces: expected at least one method"),
        ({"spaces": {"plbz": {}}}, "study.spaces: 'plbz' is unknown"),
        ({"spaces": {"plbs": {"lambda": {"log": [1, 2]}}}}, "study.spaces.plbs: 'lambda' is unknown.*'lambda_reg'"),
    ],
)
def test_what_cannot_be_searched_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        configured(**change)


def test_the_smallest_error_is_chosen() -> None:
    assert choice(pd.Series([1.001, 1.0, 1.002])) == 1
    assert choice(pd.Series([1.0, np.nan, 1.002])) == 0
    assert choice(pd.Series([np.nan] * 3)) is None


def small(folder: Path) -> str:
    """Run a small study on toy heads; returns what it prints."""
    output = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_module, "_dataset", lambda config, console: toy(identities=3))
        run_module.run(composed("run", SMALL), folder, Console(file=output, width=80))
    return output.getvalue()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder and what was printed."""
    folder = tmp_path_factory.mktemp("tuning")
    configurations = {path: path.read_bytes() for path in CONF.rglob("*.yaml")}
    printed = small(folder)
    assert configurations == {path: path.read_bytes() for path in CONF.rglob("*.yaml")}
    return folder, printed


def test_the_error_of_a_trial_is_the_mean_distance_over_the_protocol(finished: tuple[Path, str]) -> None:
    """A second implementation of protocol and measure, trial by trial."""
    trials = pd.read_csv(finished[0] / "trials.csv")
    data = toy(identities=3)
    everything = range(len(data.expressions))
    mine = trials[trials["method"] == "lbs"]
    assert len(mine) == 3
    for value, *errors in mine[["lambda_reg", "error_2", "error_5", "error"]].to_numpy():
        expected = []
        for count in (2, 5):
            distances = []
            for a, b in itertools.permutations(data.identities, 2):
                drawn = draw(a, b, 0, len(data.expressions), 3, seed=0)
                source, target = data.frames(a, everything), data.frames(b, everything)
                known, test = list(drawn.examples(count)), list(drawn.test)
                method = make_method("lbs", lambda_reg=float(value))
                prepared = method.prepare(Pair(data.faces, data.neutral(a), data.neutral(b), data.regions))
                result = prepared.fit(Examples(target[known], source[known]), source)(source[test])
                distances.append(np.linalg.norm(result.frames - target[test], axis=-1).mean())
            expected.append(np.mean(distances))
        np.testing.assert_allclose(errors, [*expected, np.mean(expected)], rtol=1e-12)


def test_a_study_leaves_its_trials_a_choice_and_its_pages(finished: tuple[Path, str]) -> None:
    folder, printed = finished
    trials = pd.read_csv(folder / "trials.csv")
    assert trials["method"].tolist() == ["lbs"] * 3 + ["delta", "lbs_paper", "neutral"]
    assert trials["chosen"].sum() == 1
    taken = trials[trials["chosen"]].iloc[0]
    said = OmegaConf.to_container(OmegaConf.load(folder / "chosen.yaml"))
    assert said == {"lbs": {"lambda_reg": taken["lambda_reg"]}}
    assert taken["error"] <= 1.01 * trials.loc[trials["method"] == "lbs", "error"].min()
    assert (folder / "chosen.yaml").read_text() in printed
    assert (folder / "tuning.pdf").read_bytes().startswith(b"%PDF")
    assert "| lbs | " in (folder / "tables.md").read_text()


def test_a_second_run_computes_nothing_and_chooses_the_same(finished: tuple[Path, str]) -> None:
    before = (finished[0] / "trials.csv").read_bytes()
    printed = small(finished[0])
    assert "72 of them finished earlier" in " ".join(printed.split())
    assert (finished[0] / "trials.csv").read_bytes() == before


def test_all_trials_see_the_same_expressions(finished: tuple[Path, str]) -> None:
    metrics = pd.read_parquet(finished[0] / "metrics.parquet")
    seen = metrics.groupby(["source", "target", "draw", "n_examples", "method"])["expression"].agg(tuple)
    assert (seen.groupby(level=[0, 1, 2]).nunique() == 1).all()


def test_a_trial_with_a_failed_cell_has_no_error_and_is_not_chosen() -> None:
    tuning = configured(trials=2, spaces={"lbs": {"lambda_reg": {"log": [1e-8, 1.0]}}}, n_examples=[2, 5])
    rows = [(row_name("lbs", trial), count, pair) for trial in (0, 1) for count in (2, 5) for pair in ("ab", "ba")]
    metrics = pd.DataFrame(
        {
            "method": method,
            "n_examples": count,
            "source": pair[0],
            "target": pair[1],
            "metric": "vertex_l2_mean",
            "region": "head",
            "value": 1.0 if method == "lbs_00" else 0.5,
        }
        for method, count, pair in rows
    )
    cells = pd.DataFrame({"method": [row[0] for row in rows], "status": "ok", "seconds_per_expression": 0.1})
    table = trial_table(tuning, metrics, cells)
    assert table["chosen"].tolist() == [False, True]
    cells.loc[5, "status"] = "failed"
    table = trial_table(tuning, metrics, cells)
    assert table["chosen"].tolist() == [True, False]
    assert table["n_failed"].tolist() == [0, 1]
    assert table["error"].isna().tolist() == [False, True]
