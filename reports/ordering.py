"""The order of methods under several conditions: ranks of means, and how far two orders agree."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import kendalltau

from reports.findings import favours
from reports.load import MethodFacts, StudyResults
from reports.text import bounds, number
from retarget.types import FloatArray

_CHECK = " (sanity)"
FEWEST = 3  # methods from which two orders are compared


@dataclass(frozen=True)
class Ordering:
    """Means of the primary measure of several studies of one kind: methods x conditions, by number of examples."""

    studies: Sequence[StudyResults]

    @cached_property
    def conditions(self) -> tuple[str, ...]:
        """Names of the studies, without the group of settings where all differ in the dataset's alone."""
        parts = [study.differs.split(", ") for study in self.studies]
        short = all(part.startswith("dataset.") for each in parts for part in each)
        return tuple(
            ", ".join(part.removeprefix("dataset.").replace("=", " ") if short else part for part in each)
            + (_CHECK if study.sanity else "")
            for study, each in zip(self.studies, parts, strict=True)
        )

    @cached_property
    def stated(self) -> tuple[int, ...]:
        """The conditions that statements are about: all but those of sanity, unless there are no others."""
        kept = [i for i, study in enumerate(self.studies) if not study.sanity]
        return tuple(kept or range(len(self.studies)))

    @cached_property
    def checks(self) -> tuple[str, ...]:
        """Names of the conditions that no statement is about."""
        return tuple(name.removesuffix(_CHECK) for i, name in enumerate(self.conditions) if i not in self.stated)

    @cached_property
    def counts(self) -> tuple[int, ...]:
        return tuple(sorted({count for study in self.studies for count in study.facts["n_examples"]}))

    @cached_property
    def methods(self) -> tuple[MethodFacts, ...]:
        """All rows, the smallest rank on average over the `stated` conditions first; references, without one, last."""
        rows = {method.name: method for study in self.studies for method in study.methods}
        average = {}
        for name in rows:
            ranks = np.concatenate([self.ranks(name, count)[list(self.stated)] for count in self.counts])
            average[name] = float(np.nanmean(ranks)) if np.isfinite(ranks).any() else np.inf
        return tuple(sorted(rows.values(), key=lambda method: (method.kind == "reference", average[method.name])))

    @cached_property
    def _tables(self) -> tuple[pd.DataFrame, ...]:
        """Of each study, the primary measure by method and number of examples, with ranks."""
        tables = []
        for study in self.studies:
            table = study.primary.set_index(["method", "n_examples"])[["mean", "ci_low", "ci_high"]].astype(np.float64)
            tested = table[table.index.get_level_values("method").isin(study.tested)]
            tables.append(table.assign(rank=tested["mean"].groupby(level="n_examples").rank(method="min")))
        return tuple(tables)

    def values(self, method: str, count: int, column: str = "mean") -> FloatArray:
        """(conditions,) a column of the summary; NaN where the method has no result."""
        at = (method, count)
        return np.array([table[column].get(at, np.nan) for table in self._tables], dtype=np.float64)

    def ranks(self, method: str, count: int) -> FloatArray:
        """(conditions,) 1 for the smallest mean among methods and controls; NaN without a result."""
        return self.values(method, count, "rank")

    def tau(self, first: int, second: int, count: int) -> float:
        """Kendall's tau-b of the means of two conditions over methods and controls with a result in both.

        NaN with fewer than `FEWEST` of them.
        """
        names = [name for name in self.studies[first].tested if name in self.studies[second].tested]
        means = np.array([self.values(name, count)[[first, second]] for name in names]).reshape(-1, 2)
        means = means[np.isfinite(means).all(axis=1)]
        return float(kendalltau(means[:, 0], means[:, 1]).statistic) if len(means) >= FEWEST else float("nan")


def overview(ordering: Ordering) -> dict[str, Any]:
    """What the page of conditions side by side prints, as plain data."""
    pairs = list(itertools.combinations(range(len(ordering.conditions)), 2))
    return {
        "conditions": ordering.conditions,
        "favours": _favours(ordering),
        "findings": list(findings(ordering)),
        "parts": [{"count": count, "rows": list(_rows(ordering, count))} for count in ordering.counts],
        "counts": ordering.counts,
        "agreement": [
            {
                "first": ordering.conditions[i],
                "second": ordering.conditions[j],
                "tau": [_two_digits(ordering.tau(i, j, count)) for count in ordering.counts],
            }
            for i, j in pairs
        ],
    }


def findings(ordering: Ordering) -> Iterator[str]:
    """A sentence or two for each number of examples: which row is first where, and how far the orders agree."""
    for count in ordering.counts:
        first: dict[str, list[str]] = {}
        for i in ordering.stated:
            ranked = {m.label: ordering.ranks(m.name, count)[i] for m in ordering.methods if m.kind != "reference"}
            best = [label for label, rank in ranked.items() if rank == 1]
            first.setdefault(" and ".join(best) or "no method", []).append(ordering.conditions[i])
        said = f"{count} examples: the smallest mean is that of "
        if len(first) == 1:
            said += f"{next(iter(first))} under every condition"
            said += f" but {' and '.join(ordering.checks)}, {_check(ordering)}." if ordering.checks else "."
        else:
            said += "; ".join(f"{label} with {' and '.join(under)}" for label, under in first.items())
            said += f". Left out: {' and '.join(ordering.checks)}, {_check(ordering)}." if ordering.checks else "."
        yield f"{said} {_agreement(ordering, count)}"


def _check(ordering: Ordering) -> str:
    return "which is a check, not evidence" if len(ordering.checks) == 1 else "which are checks, not evidence"


def _agreement(ordering: Ordering, count: int) -> str:
    taus = {(i, j): ordering.tau(i, j, count) for i, j in itertools.combinations(ordering.stated, 2)}
    known = {pair: tau for pair, tau in taus.items() if np.isfinite(tau)}
    if not known:
        return f"Orders of fewer than {FEWEST} methods are not compared."
    if np.isclose(min(known.values()), 1):
        return f"The order of methods is the same under {'these' if ordering.checks else 'all'} conditions."
    (i, j), least = min(known.items(), key=lambda item: item[1])
    pair = f"{ordering.conditions[i]} and {ordering.conditions[j]}"
    if len(known) == 1:
        return f"The orders differ: Kendall's tau is {_two_digits(least)}."
    return f"The orders differ most between {pair}: Kendall's tau is {_two_digits(least)}."


def _favours(ordering: Ordering) -> list[tuple[str, str]]:
    """(conditions, what their truth favours), those with the same words together."""
    texts: dict[str, list[str]] = {}
    for name, study in zip(ordering.conditions, ordering.studies, strict=True):
        texts.setdefault(favours(study), []).append(name)
    return [(", ".join(names), text) for text, names in texts.items()]


def _rows(ordering: Ordering, count: int) -> Iterator[dict[str, Any]]:
    for method in ordering.methods:
        means, ranks = ordering.values(method.name, count), ordering.ranks(method.name, count)
        lows, highs = (ordering.values(method.name, count, column) for column in ("ci_low", "ci_high"))
        yield {
            "label": method.label,
            "kind": method.kind,
            "cells": [
                {
                    "mean": number(mean) if np.isfinite(mean) else "no result",
                    "interval": bounds(low, high) if np.isfinite(mean) else "",
                    "rank": f"{rank:.0f}" if np.isfinite(rank) else "",
                    "best": bool(rank == 1),
                }
                for mean, low, high, rank in zip(means, lows, highs, ranks, strict=True)
            ],
        }


def _two_digits(tau: float) -> str:
    return number(tau, 2)
