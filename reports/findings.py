"""What a study may claim: a difference only where the tests on pairs, sources and targets and the interval agree."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from reports.load import StudyResults
from reports.text import estimate, number

ALPHA = 0.05
PER_COMPARISON = (
    "Each claim holds by itself at about 5 %, not all of them together: Holm's correction covers the test on pairs, "
    "while the tests on people, which the few identities limit, are uncorrected."
)
_CHECK = (
    "This truth is a check, not evidence: a method is exact on it by construction, so no difference is claimed from it."
)


def supported(test: pd.Series[float]) -> bool:
    """Whether all analyses of a row of `summary.paired_tests` find a difference at 5 %, in one direction.

    With crossed effects of sources and targets one of the tests on people is not enough: the other effect shifts
    all its values together. Both, with the interval, keep the rate of false claims near 5 % per comparison.
    """
    excluded = test["ratio_high"] < 1 or test["ratio_low"] > 1
    agree = np.sign(test["effect"]) == np.sign(np.log(test["ratio"]))
    return bool((test[["p_holm", "p_sources", "p_targets"]] < ALPHA).all() and excluded and agree)


def findings(study: StudyResults, tests: pd.DataFrame) -> tuple[str, ...]:
    """Statements for the title page, one per example count; tests are those of the primary family."""
    said = [_at(study, tests, count) for count in study.facts["n_examples"]]
    said.append(_limit(study) or (_CHECK if study.sanity else PER_COMPARISON))
    without = int((~study.cells["status"].isin(["ok", "not_converged"])).sum())
    late = int((study.cells["status"] == "not_converged").sum())
    total = len(study.cells)
    if without:
        said.append(
            f"{without} of {total} cells have no result; they are listed with their reasons, and means leave out their "
            "pairs and draws for every method."
        )
    if late:
        said.append(f"{late} of {total} cells stopped at an iteration limit; their results are used and listed.")
    return tuple(said)


def _at(study: StudyResults, tests: pd.DataFrame, count: int) -> str:
    rows = study.primary
    rows = rows[(rows["n_examples"] == count) & rows["method"].isin(study.tested) & rows["mean"].notna()]
    if rows.empty:
        return f"{count} examples: no cell was finished by all compared methods."
    best = rows.iloc[int(np.argmin(rows["mean"]))]
    unit = study.unit
    value = estimate(best["mean"], best["ci_low"], best["ci_high"])
    control = " (control)" if study.kind(best["method"]) == "control" else ""
    name = f"{study.label(best['method'])}{control}"
    said = [f"{count} examples: the smallest mean error is that of {name}, {value} {unit}"]
    reference = rows[rows["method"] == study.facts["reference"]]
    if best["method"] == study.facts["reference"]:
        said[0] += " (the reference)."
    elif len(reference):
        r = reference.iloc[0]
        value = estimate(r["mean"], r["ci_low"], r["ci_high"])
        said[0] += f"; the reference, {study.label(r['method'])}, has {value} {unit}."
    else:
        said[0] += f"; the reference, {study.label(study.facts['reference'])}, has no result."
    if study.sanity:
        return said[0]
    here = tests[(tests["n_examples"] == count) & (tests["n_pairs"] > 0)]
    claims = [row for _, row in here.iterrows() if supported(row)]
    for smaller, word in ((True, "smaller"), (False, "larger")):
        names = [_claim(study, row) for row in claims if (row["ratio"] < 1) == smaller]
        if names:
            than = f"Error {word} than that of {study.label(study.facts['reference'])}, ratio [95 % interval]"
            said.append(f"{than}: {', '.join(names)}.")
    unclaimed = [study.label(str(row["method"])) for _, row in here.iterrows() if not supported(row)]
    if unclaimed and not _limit(study):
        said.append(f"No difference to it is claimed for {', '.join(unclaimed)}.")
    return " ".join(said)


def _claim(study: StudyResults, row: pd.Series[float]) -> str:
    return f"{study.label(str(row['method']))} {estimate(row['ratio'], row['ratio_low'], row['ratio_high'], digits=2)}"


def _limit(study: StudyResults) -> str:
    people = len(study.facts["identities"])
    smallest = 2.0 ** (1 - people)
    if people < 4:
        return f"With {people} identities nothing is testable; all figures describe these people alone."
    if smallest > ALPHA:
        return (
            f"With {people} identities the smallest p that a test on source or target means can give is "
            f"{number(smallest)}, so no difference can be claimed at 5 % here. Ratios and intervals describe these "
            "identities; run at least 6 identities for claims."
        )
    return ""


def favours(study: StudyResults) -> str:
    """What the dataset says of its truth: which methods it resembles, and what it cannot show."""
    return " ".join(str(study.facts["dataset"]["favours"]).split())


def conditions(study: StudyResults) -> str:
    """The conditions of every statement, in one line."""
    data = study.facts["dataset"]
    correspondence = study.cells["correspondence"].iloc[0]
    noise = f"{data['noise_mm']:g} mm noise" if not math.isclose(data["noise_mm"], 0.0) else "no noise"
    return (
        f"dataset {data['name']}, truth {data['truth']}, weights {data['weights']}, {noise}, "
        f"correspondence {correspondence}"
    )
