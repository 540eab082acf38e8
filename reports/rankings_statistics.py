"""What rankings say: mean ranks with their spread, and tests against a reference that respect who and what they cover.

Ranks of one participant are not independent, and neither are ranks of one item: both are averaged before a test. A
test on participants speaks about other people on these items, a test on items about other items and these people;
claim what both support. The pooled test, in which every single ranking counts, is printed for contrast.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import friedmanchisquare
from scipy.stats import t as student

from reports.rankings import Rankings
from reports.statistics import LEVEL, holm, rank_biserial, wilcoxon, win_rate
from retarget.types import FloatArray

MIN_CLUSTERS = 6  # participants, or items: with fewer a signed-rank test cannot reach 5 %, p >= 2^(1 - n)
SIGNIFICANT = 0.05


@dataclass(frozen=True)
class MeanRank:
    """Mean rank of a method; 1 is best."""

    method: str
    mean: float  # over participants, of each participant's mean over items
    low: float  # nominal 95 % interval over participants (Student); NaN with one participant
    high: float
    spread: float  # standard deviation of the single ranks
    first: float  # share of items on which a participant ranked it first, ties shared
    by_error: float  # mean rank by vertex error on the same items: a metric, no rater


@dataclass(frozen=True)
class RankTest:
    """A method against the reference; p are two-sided Wilcoxon signed-rank tests, NaN where not testable."""

    method: str
    difference: float  # mean rank of the method - the reference's; positive: the reference is preferred
    effect: float  # matched-pairs rank-biserial over participants; positive: the reference is preferred
    wins: float  # share of participants with a smaller mean rank for the reference
    p: float  # one value per participant
    p_holm: float  # over the methods of one part, or over all methods and counts of the parts by count
    p_items: float  # one value per item
    p_items_holm: float
    p_pooled: float  # every single ranking as if independent: shown for contrast, never claimed


@dataclass(frozen=True)
class Part:
    """All items, or those of one example count (n_examples)."""

    n_examples: int | None
    participants: int
    items: int
    rankings: int  # of an item by a participant
    ranks: tuple[MeanRank, ...]
    tests: tuple[RankTest, ...]
    friedman: float  # p that all methods are ranked alike, on participants' means
    agreement: float  # Kendall's W of participants' means, 0 to 1


def analyse(rankings: Rankings) -> tuple[Part, ...]:
    """All items together, then each example count. Holm's correction covers the first, and apart all of the others."""
    counts = rankings.key.counts
    combined = _part(rankings, None)
    if len(counts) == 1:
        return (_adjusted([combined])[0],)
    return (*_adjusted([combined]), *_adjusted([_part(rankings, count) for count in counts]))


def supported(test: RankTest) -> bool:
    """Whether both tests find a difference at 5 % after Holm's correction, in the same direction."""
    return test.p_holm < SIGNIFICANT and test.p_items_holm < SIGNIFICANT and test.difference * test.effect > 0


def participant_means(ranks: pd.DataFrame) -> pd.DataFrame:
    """Mean rank of each method (columns) by each participant (rows) over the items."""
    return ranks.pivot_table(index="participant", columns="method", values="rank", aggfunc="mean", sort=True)


def _part(rankings: Rankings, count: int | None) -> Part:
    key, ranks = rankings.key, rankings.ranks
    mine = ranks if count is None else ranks[ranks["n_examples"] == count]
    single = mine.pivot(index=["participant", "item"], columns="method", values="rank")
    by_participant = participant_means(mine)
    by_item = mine.pivot_table(index="item", columns="method", values="rank", aggfunc="mean", sort=True)
    errors = _error_ranks(rankings, set(mine["item"]))
    shown = tuple(_mean_rank(m, by_participant, single, errors) for m in key.methods) if len(mine) else ()
    tests = tuple(
        _test(m, key.reference, by_participant, by_item, single)
        for m in key.methods
        if m != key.reference and len(mine)
    )
    friedman, agreement = _friedman(by_participant.to_numpy(dtype=np.float64))
    return Part(count, len(by_participant), len(by_item), len(single), shown, tests, friedman, agreement)


def _mean_rank(method: str, people: pd.DataFrame, single: pd.DataFrame, errors: Mapping[str, float]) -> MeanRank:
    means = people[method].to_numpy(dtype=np.float64)
    mean, n = float(means.mean()), len(means)
    half = float("nan")
    if n > 1:
        half = float(student.ppf((1 + LEVEL) / 2, n - 1) * means.std(ddof=1) / np.sqrt(n))
    ranks = single[method].to_numpy(dtype=np.float64)
    best = single.to_numpy(dtype=np.float64) == single.min(axis=1).to_numpy(dtype=np.float64)[:, None]
    first = (best / best.sum(axis=1, keepdims=True))[:, list(single.columns).index(method)]
    spread = float(ranks.std(ddof=1)) if len(ranks) > 1 else float("nan")
    return MeanRank(method, mean, mean - half, mean + half, spread, float(first.mean()), errors[method])


def _test(method: str, reference: str, people: pd.DataFrame, items: pd.DataFrame, single: pd.DataFrame) -> RankTest:
    value, other = people[method].to_numpy(), people[reference].to_numpy()
    return RankTest(
        method=method,
        difference=float(np.mean(value - other)),
        effect=rank_biserial(_rounded(value - other), np.zeros(len(value))),
        wins=win_rate(_rounded(other - value), np.zeros(len(value))),
        p=_p(value - other),
        p_holm=float("nan"),
        p_items=_p((items[method] - items[reference]).to_numpy()),
        p_items_holm=float("nan"),
        p_pooled=_p((single[method] - single[reference]).to_numpy()),
    )


def _p(difference: FloatArray) -> float:
    difference = _rounded(difference)
    return wilcoxon(difference, np.zeros(len(difference))) if len(difference) >= MIN_CLUSTERS else float("nan")


def _rounded(difference: FloatArray) -> FloatArray:
    """Means of ranks are fractions; what differs in the last bits alone is a tie."""
    return np.asarray(np.round(difference, 9), dtype=np.float64)


def _adjusted(parts: list[Part]) -> list[Part]:
    """The parts with the p-values of all their tests corrected as one family."""
    tests = [test for part in parts for test in part.tests]
    people = iter(holm([test.p for test in tests]).tolist())
    items = iter(holm([test.p_items for test in tests]).tolist())
    adjusted = []
    for part in parts:
        mine = tuple(
            RankTest(**{**vars(test), "p_holm": next(people), "p_items_holm": next(items)}) for test in part.tests
        )
        adjusted.append(Part(**{**vars(part), "tests": mine}))
    return adjusted


def _friedman(means: FloatArray) -> tuple[float, float]:
    """(p, Kendall's W) of (participants, methods) means; NaN below 3 methods or MIN_CLUSTERS participants."""
    n, k = means.shape if means.ndim == 2 else (0, 0)
    if k < 3 or n < MIN_CLUSTERS:
        return float("nan"), float("nan")
    means = _rounded(means)
    if (means == means[:, :1]).all():
        return 1.0, 0.0
    found = friedmanchisquare(*means.T)
    return float(found.pvalue), float(found.statistic) / (n * (k - 1))


def _error_ranks(rankings: Rankings, items: set[int]) -> dict[str, float]:
    """Mean rank of each method by its vertex error on these items."""
    shown = [item for item in rankings.key.items if item.number in items]
    methods = rankings.key.methods
    errors = np.array([[item.vertex_error_mm[m] for m in methods] for item in shown]).reshape(-1, len(methods))
    smaller = (errors[:, None, :] < errors[:, :, None]).sum(axis=2)
    same = (errors[:, None, :] == errors[:, :, None]).sum(axis=2)
    ranks = smaller + (same + 1) / 2
    return dict(zip(methods, ranks.mean(axis=0).tolist() if len(shown) else [np.nan] * len(methods), strict=True))
