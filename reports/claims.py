"""Published claims beside ours: each is decided from records, by a rule that was written down before.

A claim about two methods is decided as a study's own statements are (`findings.supported`): the test on pairs with
Holm's correction over all such claims, the tests on sources and on targets, and the bootstrap interval have to agree.
That two methods are alike is decided by the interval alone: inside the margin, outside, or, where it overlaps a bound,
neither.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from reports.cells import CONDITIONS, FINISHED
from reports.findings import ALPHA, supported
from reports.load import StudyResults
from reports.statistics import holm
from reports.summary import paired_tests
from reports.text import estimate, number, p_value
from retarget.check import InvalidInput
from retarget.suggest import choose

CLAIMS = Path(__file__).with_name("claims.yaml")
COMPARED = ("smaller", "fades")  # rules that are tests, and so count in Holm's correction
LIMITED = ("at_least", "at_most")
RULES = (*COMPARED, "alike", *LIMITED, "people")
FEWEST = math.ceil(1 - math.log2(ALPHA))  # people: with k the tests on sources and targets give no p below 2^(1-k)
_CELL = ["source", "target", "draw"]


class Status(StrEnum):
    REPRODUCED = "reproduced"
    NOT_REPRODUCED = "not reproduced"
    INCONCLUSIVE = "inconclusive"  # of a claim that two are alike: neither shown nor refuted
    NOT_TESTABLE = "not testable"


@dataclass(frozen=True)
class Claim:
    """One entry of the file; see its head for what a rule decides."""

    section: str
    says: str
    rule: str
    method: str = ""
    other: str = ""
    metric: str = "vertex_l2_mean"
    region: str = "head"
    counts: tuple[int, ...] = ()
    margin: float = 0.0
    published: str = ""
    of: str = ""
    column: str = ""
    per: str = ""
    where: Mapping[str, Any] = field(default_factory=dict)
    requires: Mapping[str, Any] = field(default_factory=dict)
    limit: float = math.nan


@dataclass(frozen=True)
class Verdict:
    """What one study says of a claim. value: ours, with its interval; empty where there is none.

    brief: the sentence in a few words, where the study decides.
    """

    study: str
    status: Status
    value: str
    sentence: str
    brief: str = ""


@dataclass(frozen=True)
class Judged:
    """A claim with what each study says of it."""

    claim: Claim
    verdicts: tuple[Verdict, ...]

    @property
    def status(self) -> Status:
        """Reproduced where every study that can test it reproduces it; not testable where none can.

        Otherwise not reproduced where one does not, and inconclusive where some leave it open.
        """
        found = {verdict.status for verdict in self.verdicts} - {Status.NOT_TESTABLE}
        return next(
            (status for status in (Status.NOT_REPRODUCED, Status.INCONCLUSIVE, Status.REPRODUCED) if status in found),
            Status.NOT_TESTABLE,
        )


def read_claims(path: Path = CLAIMS) -> tuple[Claim, ...]:
    """The claims of a file; one with several counts becomes one for each, `fades` excepted, which needs two.

    Raises InvalidInput for an entry that is no claim.
    """
    known = [f.name for f in fields(Claim)]
    claims = []
    for i, entry in enumerate(yaml.safe_load(path.read_text(encoding="utf-8"))):
        where = f"{path.name}, claim {i + 1}"
        for name in entry:
            choose(where, name, known)
        if missing := [name for name in ("section", "says", "rule") if name not in entry]:
            raise InvalidInput(f"{where}: expected the entries {', '.join(missing)}.")
        choose(f"{where}, rule", entry["rule"], RULES)
        claim = Claim(**{**entry, "counts": tuple(entry.get("counts", ()))})
        if claim.rule == "fades" and len(claim.counts) != 2:
            raise InvalidInput(f"{where}: 'fades' compares two counts, got {list(claim.counts)}.")
        if claim.rule in ("smaller", "alike") and not (claim.method and claim.other and claim.counts):
            raise InvalidInput(f"{where}: '{claim.rule}' needs method, other and counts.")
        if claim.rule in LIMITED and not (claim.of and claim.column and math.isfinite(claim.limit)):
            raise InvalidInput(f"{where}: '{claim.rule}' needs of, column and limit.")
        split = claim.rule in ("smaller", "alike")
        claims += [_with_counts(claim, (count,)) for count in claim.counts] if split else [claim]
    return tuple(claims)


def _with_counts(claim: Claim, counts: tuple[int, ...]) -> Claim:
    return Claim(**{f.name: getattr(claim, f.name) for f in fields(Claim)} | {"counts": counts})


def compared(claim: Claim) -> str:
    """What our value is, in words."""
    if claim.rule in (*LIMITED, "people"):
        return ""
    name = "error" if claim.metric == "vertex_l2_mean" else claim.metric.replace("_", " ")
    if claim.rule == "fades":
        few, many = claim.counts
        return f"advantage over {claim.other} with {few} / with {many}"
    return f"{name} of {claim.method} / of {claim.other}"


def family(claims: Sequence[Claim]) -> int:
    """The claims of a difference: Holm's correction counts all of them, tested or not."""
    return sum(claim.rule in COMPARED for claim in claims)


def judge(
    claims: Sequence[Claim],
    studies: Mapping[str, StudyResults],
    tables: Mapping[str, Mapping[str, pd.DataFrame]] | None = None,
) -> tuple[Judged, ...]:
    """Decide every claim. studies: comparisons by the name to print; tables: of each kind (`of`), by study."""
    found: dict[int, list[Verdict]] = {i: [] for i in range(len(claims))}
    for name, study in studies.items():
        for i, verdict in _of_study(claims, name, study):
            found[i].append(verdict)
    for i, claim in enumerate(claims):
        if claim.rule in LIMITED:
            found[i] += [_limited(claim, name, table) for name, table in (tables or {}).get(claim.of, {}).items()]
        if not found[i]:
            found[i].append(Verdict("", Status.NOT_TESTABLE, "", _why_nothing(claim)))
    return tuple(Judged(claim, tuple(found[i])) for i, claim in enumerate(claims))


def _why_nothing(claim: Claim) -> str:
    if claim.rule == "people":
        return "Only people can judge this; no record here holds a ranking that people gave."
    if claim.rule in LIMITED:
        return f"No study of the kind {claim.of} is among the results."
    return "No study here measured both methods with these numbers of examples."


def _of_study(claims: Sequence[Claim], name: str, study: StudyResults) -> Iterator[tuple[int, Verdict]]:
    seed = int(study.facts["provenance"]["seed"])
    tested = {i: _test(claim, study, seed) for i, claim in enumerate(claims) if claim.rule in (*COMPARED, "alike")}
    tests = {i: row for i, row in tested.items() if row is not None}
    run, declared = [i for i in tests if claims[i].rule in COMPARED], family(claims)
    corrected = dict(zip(run, holm([tests[i]["p"] for i in run], declared), strict=True))
    for i, row in tests.items():
        yield i, _compared(claims[i], name, row | {"p_holm": corrected.get(i, math.nan), "family": declared})


def _test(claim: Claim, study: StudyResults, seed: int) -> dict[str, Any] | None:
    """A row of `summary.paired_tests` with the number of people; None where the study lacks what the claim names."""
    m = study.metrics
    rows = m[
        (m["metric"] == claim.metric)
        & (m["region"] == claim.region)
        & m["method"].isin([claim.method, claim.other])
        & m["n_examples"].isin(claim.counts)
    ]
    if rows.groupby(["method", "n_examples"], observed=True).ngroups < 2 * len(claim.counts):
        return None
    if claim.rule == "fades":
        rows, method, other = _advantages(rows, claim), "few", "many"
    else:
        method, other = claim.method, claim.other
    table = paired_tests(rows, other, [method], claim.metric, claim.region, seed) if len(rows) else pd.DataFrame()
    if len(table) != 1 or not table["n_pairs"].iloc[0]:
        return {"n_pairs": 0, "people": 0, "p": math.nan}
    done = rows[rows["status"].isin(FINISHED)]
    people = min(done["source"].nunique(), done["target"].nunique())
    return {str(k): v for k, v in table.iloc[0].items()} | {"people": people}


def _advantages(rows: pd.DataFrame, claim: Claim) -> pd.DataFrame:
    """Rows `few` and `many`: other / method of each cell at the two counts, where all four values are known."""
    done = rows[rows["status"].isin(FINISHED)]
    means = (
        done.groupby([*_CELL, "n_examples", "method"], observed=True)["value"].mean().unstack(["n_examples", "method"])
    )
    wanted = [(count, method) for count in claim.counts for method in (claim.method, claim.other)]
    if any(column not in means for column in wanted):
        return rows.iloc[:0]
    means = means[wanted].dropna()
    means = means[(means > 0).all(axis=1)]
    parts = [
        (means[(count, claim.other)] / means[(count, claim.method)]).rename("value").reset_index().assign(method=label)
        for label, count in zip(("few", "many"), claim.counts, strict=True)
    ]
    same: dict[str, Any] = {
        "n_examples": 0,
        "expression": "all",
        "metric": claim.metric,
        "region": claim.region,
        "unit": "1",
    }
    same |= {name: rows[name].iloc[0] for name in CONDITIONS}
    return pd.concat(parts, ignore_index=True).assign(status="ok", **same)


def _compared(claim: Claim, name: str, row: Mapping[str, Any]) -> Verdict:
    if not row["n_pairs"]:
        return Verdict(name, Status.NOT_TESTABLE, "", "No cell was finished by both.")
    value = estimate(row["ratio"], row["ratio_low"], row["ratio_high"], digits=2)
    size = f"{int(row['n_pairs'])} pair{'s' if row['n_pairs'] > 1 else ''} of {row['people']} people"
    if not math.isfinite(row["ratio"]):
        return Verdict(name, Status.NOT_TESTABLE, "", f"A value is zero or negative, so there is no ratio ({size}).")
    if row["people"] < FEWEST:
        return Verdict(name, Status.NOT_TESTABLE, value, f"A claim needs at least {FEWEST} people; here {size}.")
    if claim.rule == "alike":
        return _alike(claim, name, row, value, size)
    wanted = row["ratio"] > 1 if claim.rule == "fades" else row["ratio"] < 1
    agreed = supported(pd.Series({key: row[key] for key in _SUPPORT}))
    p = p_value(row["p_holm"])
    p = p if p.startswith("<") else f"= {p}"
    status = Status.REPRODUCED if agreed and wanted else Status.NOT_REPRODUCED
    said, brief = "No difference that all analyses support", "no difference"
    if agreed:
        said, brief = ("All analyses agree", "agree") if wanted else ("All analyses agree on the opposite", "opposite")
    sentence = f"{said} ({size}; p {p}, Holm over the {row['family']} claims of a difference)."
    return Verdict(name, status, value, sentence, f"{brief}, p {p}")


_SUPPORT = ["p_holm", "p_sources", "p_targets", "ratio", "ratio_low", "ratio_high", "effect"]


def _alike(claim: Claim, name: str, row: Mapping[str, Any], value: str, size: str) -> Verdict:
    low, high = 1 / (1 + claim.margin), 1 + claim.margin
    band = f"{number(low, 2)} to {number(high, 2)}"
    if low <= row["ratio_low"] and row["ratio_high"] <= high:
        status, said, brief = Status.REPRODUCED, "lies inside", "inside"
    elif row["ratio_high"] < low or high < row["ratio_low"]:
        status, said, brief = Status.NOT_REPRODUCED, "lies outside", "outside"
    else:
        status, said, brief = Status.INCONCLUSIVE, "overlaps a bound of", "overlaps"
    return Verdict(name, status, value, f"The interval {said} {band} ({size}).", f"{brief} {band}")


def _limited(claim: Claim, name: str, table: pd.DataFrame) -> Verdict:
    rows = table
    for column, wanted in claim.where.items():
        rows = rows[rows[column] == wanted] if column in rows else rows.iloc[:0]
    columns = [claim.column, *([claim.per] if claim.per else [])]
    if len(rows) != 1 or any(column not in rows for column in columns):
        said = ", ".join(f"{key} {wanted}" for key, wanted in claim.where.items())
        return Verdict(name, Status.NOT_TESTABLE, "", f"The study has no value for {said}.")
    row = rows.iloc[0]
    for column, wanted in claim.requires.items():
        if column not in row or row[column] != wanted:
            said = row.get(column, "nothing")
            return Verdict(name, Status.NOT_TESTABLE, "", f"The claim is about {column} {wanted}; this is {said}.")
    value = float(row[claim.column]) / (float(row[claim.per]) if claim.per else 1.0)
    if not np.isfinite(value):
        return Verdict(name, Status.NOT_TESTABLE, "", "The study has no finite value.")
    kept = value >= claim.limit if claim.rule == "at_least" else value <= claim.limit
    said = f"{'at least' if claim.rule == 'at_least' else 'at most'} {claim.limit:g}"
    shown = f"{row[claim.column]:g} of {row[claim.per]:g}" if claim.per else number(value, 2)
    status = Status.REPRODUCED if kept else Status.NOT_REPRODUCED
    return Verdict(name, status, shown, f"Expected {said}. One machine, one run: a value, no test.", said)
