"""The study `tuning`: a comparison whose rows are trials of settings, and the choice among them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import OmegaConf

from experiments.catalogue import method_settings, options
from experiments.spaces import Space, Trial
from experiments.study import Study
from reports.cells import FINISHED
from retarget.check import InvalidInput, check_whole
from retarget.suggest import choose


@dataclass(frozen=True)
class Tuning:
    """``conf/study/tuning.yaml``. trials: by method, the present configuration first. study: each trial is a row."""

    study: Study
    spaces: Mapping[str, Space]
    trials: Mapping[str, tuple[Trial, ...]]

    @staticmethod
    def from_config(config: Mapping[str, Any], methods: Mapping[str, Mapping[str, Any]]) -> Tuning:
        """Of a study's settings and those of the chosen methods. Raises InvalidInput for what cannot be searched."""
        rest = dict(config)
        count, described = (rest.pop(name) for name in ("trials", "spaces"))
        rest.pop("first_seed", None)  # the dataset's
        check_whole("study.trials", count, 1)
        if not isinstance(described, Mapping) or not described:
            raise InvalidInput(f"study.spaces: expected at least one method to tune, got {described!r}.")
        spaces = {}
        for method, space in described.items():
            choose("study.spaces", method, options("method"))
            spaces[method] = Space.from_config(method, space, methods.get(method) or method_settings(method))
        trials = {method: space.trials(count, rest["seed"]) for method, space in spaces.items()}
        rows = {
            row_name(method, number): {"of": method, **trial.settings}
            for method, listed in trials.items()
            for number, trial in enumerate(listed)
        }
        rest["variants"] = {**rest.get("variants", {}), **rows}
        rest["reference"] = rest["reference"] or next(iter(rows))
        return Tuning(Study.from_config(rest), spaces, trials)


def row_name(method: str, trial: int) -> str:
    return f"{method}_{trial:02d}"


def trial_table(tuning: Tuning, metrics: pd.DataFrame, cells: pd.DataFrame) -> pd.DataFrame:
    """One row for each trial, and one for each other row, whose trial is empty.

    Columns: method, trial, `error_<count>` in mm for each number of examples and `error`, their mean, both over all
    pairs, draws and expressions and empty unless every cell finished; n_failed, seconds_per_expression (median), chosen
    (see `choice`), and each searched setting, empty where it is not searched.
    """
    study = tuning.study
    measured = metrics[(metrics["metric"] == study.primary_metric) & (metrics["region"] == study.primary_region)]
    per_pair = measured.groupby(["method", "n_examples", "source", "target"])["value"].mean()
    errors = per_pair.groupby(level=[0, 1]).mean().unstack()
    failed = (~cells["status"].isin(FINISHED)).groupby(cells["method"]).sum()
    seconds = cells.groupby("method")["seconds_per_expression"].median()
    known = {
        row_name(method, number): {"method": method, "trial": number, **trial.values}
        for method, trials in tuning.trials.items()
        for number, trial in enumerate(trials)
    }
    names = [*known, *(name for name in dict.fromkeys(cells["method"]) if name not in known)]
    described = pd.DataFrame([known.get(name, {"method": name}) for name in names])
    found = errors.reindex(names)[list(study.n_examples)].add_prefix("error_").reset_index(drop=True)
    lost = failed.reindex(names).to_numpy()
    found["error"] = found.mean(axis=1)
    found[lost > 0] = np.nan
    found["n_failed"] = lost
    found["seconds_per_expression"] = seconds.reindex(names).to_numpy()
    table = pd.concat([described[["method", "trial"]].astype({"trial": "Int64"}), found], axis=1)
    table["chosen"] = False
    for method in tuning.spaces:
        number = choice(table.loc[table["method"] == method, "error"])
        table.loc[(table["method"] == method) & (table["trial"] == number), "chosen"] = number is not None
    return pd.concat([table, described.drop(columns=["method", "trial"])], axis=1)


def choice(errors: pd.Series[float]) -> int | None:
    """The number of the trial with the smallest error; None where none has one."""
    error = errors.to_numpy(dtype=np.float64)
    return None if np.isnan(error).all() else int(np.nanargmin(error))


def chosen_yaml(tuning: Tuning, trials: pd.DataFrame) -> str:
    """What to put into each method's YAML: the chosen value of every setting that was searched."""
    numbers = trials[trials["chosen"]].set_index("method")["trial"]
    parts = []
    for method in tuning.spaces:
        if method not in numbers:
            parts.append(f"# {method}: no trial finished every cell\n")
            continue
        trial = tuning.trials[method][int(numbers[method])]
        said = "as it is" if numbers[method] == 0 else f"trial {numbers[method]}"
        parts.append(f"# {said}\n" + OmegaConf.to_yaml({method: dict(trial.settings)}))
    return "".join(parts)
