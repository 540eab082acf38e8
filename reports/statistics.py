"""Statistics for samples that cluster by identity: tests, effect sizes and bootstrap intervals on plain arrays.

Every (source, target) pair gives one value per method. Pairs share people, so a test on pairs is printed beside
tests on source means and on target means and a bootstrap that resamples sources, targets and example draws; claim
what all of them support.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import rankdata
from scipy.stats import wilcoxon as _wilcoxon

from retarget.types import FloatArray, IntArray

MIN_IDENTITIES = 4  # below, a p-value is `not testable` and given as NaN
MIN_RESAMPLED = 3  # sources and targets; a bootstrap of fewer would show certainty that is not there
REPLICATES = 2000
LEVEL = 0.95


def wilcoxon(values: ArrayLike, reference: ArrayLike) -> float:
    """Two-sided p of the paired Wilcoxon signed-rank test on (m,) values; NaN without a pair, 1 if all are equal."""
    difference = np.subtract(values, reference)
    if len(difference) == 0:
        return float("nan")
    if not np.any(difference):
        return 1.0
    return float(_wilcoxon(difference, zero_method="wilcox", alternative="two-sided").pvalue)


def rank_biserial(values: ArrayLike, reference: ArrayLike) -> float:
    """Matched-pairs rank-biserial correlation in [-1, 1] (Kerby 2014); positive where values exceed the reference."""
    difference = np.subtract(values, reference)
    difference = difference[difference != 0]
    if len(difference) == 0:
        return 0.0
    ranks = rankdata(np.abs(difference))
    return float(np.sum(np.sign(difference) * ranks) / np.sum(ranks))


def win_rate(values: ArrayLike, reference: ArrayLike) -> float:
    """Share of pairs (m,) with a smaller value than the reference; a tie counts half."""
    difference = np.subtract(values, reference)
    if len(difference) == 0:
        return float("nan")
    return float(np.mean((difference < 0) + 0.5 * (difference == 0)))


def geometric_mean_ratio(values: ArrayLike, reference: ArrayLike) -> float:
    """exp of the mean log ratio of positive (m,) values; NaN where a value is not positive."""
    v, r = np.asarray(values, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if len(v) == 0 or (v <= 0).any() or (r <= 0).any():
        return float("nan")
    return float(np.exp(np.mean(np.log(v) - np.log(r))))


def holm(p: ArrayLike, size: int = 0) -> FloatArray:
    """Step-down adjusted p-values of one family (Holm 1979); NaN stays NaN and does not count as a test.

    size is the declared number of tests, where it exceeds those given: what was not run costs as if it had been.
    """

    def step_down(ordered: FloatArray) -> FloatArray:
        m = max(size, len(ordered))
        return np.maximum.accumulate(ordered * (m - np.arange(len(ordered))))

    return _adjust(p, step_down)


def benjamini_hochberg(p: ArrayLike) -> FloatArray:
    """Adjusted p-values that control the false discovery rate (Benjamini and Hochberg 1995); NaN stays NaN."""

    def step_up(ordered: FloatArray) -> FloatArray:
        m = len(ordered)
        return np.minimum.accumulate((ordered * m / np.arange(1, m + 1))[::-1])[::-1]

    return _adjust(p, step_up)


@dataclass(frozen=True)
class Clusters:
    """Which source, target and pair each cell belongs to.

    Cells are (pair, draw); a draw is nested in its pair, because each pair draws its own examples.
    """

    sources: IntArray  # (p,) index of each pair's source
    targets: IntArray  # (p,) index of each pair's target
    pair: IntArray  # (c,) index of each cell's pair

    @staticmethod
    def of(sources: Sequence[str], targets: Sequence[str]) -> Clusters:
        """From the names of each cell's source and target, both (c,)."""
        cells = np.column_stack([np.asarray(sources, dtype=str), np.asarray(targets, dtype=str)])
        pairs, pair = np.unique(cells, axis=0, return_inverse=True)
        pair = np.asarray(pair).reshape(-1)
        if len(pairs) == 0:
            empty = np.empty(0, dtype=np.int64)
            return Clusters(empty, empty, empty)
        return Clusters(
            np.unique(pairs[:, 0], return_inverse=True)[1], np.unique(pairs[:, 1], return_inverse=True)[1], pair
        )

    @property
    def count(self) -> int:
        """The number of pairs."""
        return len(self.sources)

    @property
    def identities(self) -> int:
        """The smaller of the numbers of sources and targets: how many people a claim rests on."""
        return min(len(np.unique(self.sources)), len(np.unique(self.targets)))

    def pair_means(self, cells: FloatArray) -> FloatArray:
        """(p, ...) means of (c, ...) cells over the draws of each pair."""
        total = np.zeros((self.count, *cells.shape[1:]))
        np.add.at(total, self.pair, cells)
        return total / np.bincount(self.pair, minlength=self.count).reshape(-1, *[1] * (cells.ndim - 1))

    def source_means(self, pairs: FloatArray) -> FloatArray:
        """(number of sources,) means of (p,) pair values over the targets of each source."""
        return np.bincount(self.sources, pairs) / np.bincount(self.sources)

    def target_means(self, pairs: FloatArray) -> FloatArray:
        """(number of targets,) means of (p,) pair values over the sources of each target."""
        return np.bincount(self.targets, pairs) / np.bincount(self.targets)


@dataclass(frozen=True)
class Resamples:
    """Bootstrap replicates of one design, shared by all methods and metrics, so that differences stay paired.

    pairs  (b, p) weight of each pair: times its source was drawn x times its target was drawn, rows sum to 1
    draws  (b, c) weight of each cell within its pair, summing to 1 over the draws of a pair
    """

    clusters: Clusters
    pairs: FloatArray
    draws: FloatArray

    @staticmethod
    def of(clusters: Clusters, seed: int, count: int = REPLICATES) -> Resamples:
        """Draw sources, targets and, within each pair, draws with replacement (two-way: Owen 2007).

        A replicate in which no drawn source meets a drawn target is left out. There are none at all with fewer than
        MIN_RESAMPLED sources or targets.
        """
        count = count if clusters.identities >= MIN_RESAMPLED else 0
        rng = np.random.default_rng(seed)
        by_source = _multiplicities(rng, clusters.sources, count)
        by_target = _multiplicities(rng, clusters.targets, count)
        weights = by_source * by_target
        valid = weights.sum(axis=1) > 0
        draws = np.zeros((count, len(clusters.pair)))
        for pair in range(clusters.count):
            cells = np.flatnonzero(clusters.pair == pair)
            draws[:, cells] = rng.multinomial(len(cells), np.full(len(cells), 1 / len(cells)), size=count) / len(cells)
        weights = weights[valid]
        return Resamples(clusters, weights / weights.sum(axis=1, keepdims=True), draws[valid])

    def means(self, cells: FloatArray) -> FloatArray:
        """(b, k) replicates of the mean over pairs of (c, k) cell values."""
        return (self.pairs[:, self.clusters.pair] * self.draws) @ cells

    def log_ratios(self, cells: FloatArray, reference: FloatArray) -> FloatArray:
        """(b,) replicates of the mean over pairs of log(value / reference), from positive (c,) cell values."""
        ratio = np.log(self._pair_values(cells)) - np.log(self._pair_values(reference))
        return np.asarray(np.sum(self.pairs * ratio, axis=1))

    def _pair_values(self, cells: FloatArray) -> FloatArray:
        starts = np.zeros((len(cells), self.clusters.count))
        starts[np.arange(len(cells)), self.clusters.pair] = cells
        return self.draws @ starts


def interval(replicates: FloatArray, level: float = LEVEL) -> tuple[FloatArray, FloatArray]:
    """Percentile interval over the first axis of (b, ...) replicates; NaN without replicates."""
    if len(replicates) == 0:
        nothing = np.full(replicates.shape[1:], np.nan)
        return nothing, nothing
    low, high = np.quantile(replicates, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return low, high


@dataclass(frozen=True)
class PairedComparison:
    """A method against a reference on cells where both finished; p-values are raw and two-sided.

    effect and tests are on log ratios, as ratio and interval are; on differences where a value is not positive.
    """

    n_pairs: int
    ratio: float  # geometric mean over pairs of method / reference
    ratio_low: float
    ratio_high: float
    win_rate: float
    effect: float  # matched-pairs rank-biserial; negative: the method's error is smaller
    p: float  # one value per pair
    p_sources: float  # one value per source
    p_targets: float  # one value per target
    p_naive: float  # every expression of every cell as if independent: shown for contrast, never claimed


def compare(
    cells: FloatArray, reference: FloatArray, resamples: Resamples, pooled: FloatArray, pooled_reference: FloatArray
) -> PairedComparison:
    """Compare (c,) cell values, and (m,) values of single expressions for the naive test, with the reference's."""
    clusters = resamples.clusters
    mine, other = clusters.pair_means(cells), clusters.pair_means(reference)
    ratio = geometric_mean_ratio(mine, other)
    low, high = float("nan"), float("nan")
    if np.isfinite(ratio):
        bounds = interval(resamples.log_ratios(cells, reference))
        low, high = (float(np.exp(bound)) for bound in bounds)
    difference = _difference(mine, other)
    by_source, by_target = clusters.source_means(difference), clusters.target_means(difference)
    return PairedComparison(
        n_pairs=clusters.count,
        ratio=ratio,
        ratio_low=low,
        ratio_high=high,
        win_rate=win_rate(mine, other),
        effect=rank_biserial(difference, np.zeros_like(difference)),
        p=_paired_p(clusters, difference),
        p_sources=_paired_p(clusters, by_source),
        p_targets=_paired_p(clusters, by_target),
        p_naive=_paired_p(clusters, _difference(pooled, pooled_reference)),
    )


def pair_p(cells: FloatArray, reference: FloatArray, clusters: Clusters) -> float:
    """`PairedComparison.p` alone."""
    return _paired_p(clusters, _difference(clusters.pair_means(cells), clusters.pair_means(reference)))


def _difference(values: FloatArray, reference: FloatArray) -> FloatArray:
    """log(values / reference), or values - reference where one is not positive."""
    if (values > 0).all() and (reference > 0).all():
        return np.asarray(np.log(values) - np.log(reference))
    return np.asarray(values - reference)


def _paired_p(clusters: Clusters, difference: FloatArray) -> float:
    testable = clusters.identities >= MIN_IDENTITIES
    return wilcoxon(difference, np.zeros_like(difference)) if testable else float("nan")


def _multiplicities(rng: np.random.Generator, labels: IntArray, count: int) -> FloatArray:
    """(count, len(labels)) how often each label's cluster was drawn."""
    clusters = int(labels.max(initial=-1)) + 1
    if clusters == 0:
        return np.zeros((count, 0))
    return rng.multinomial(clusters, np.full(clusters, 1 / clusters), size=count)[:, labels].astype(np.float64)


def _adjust(p: ArrayLike, step: Callable[[FloatArray], FloatArray]) -> FloatArray:
    raw = np.asarray(p, dtype=np.float64)
    adjusted = np.full(raw.shape, np.nan)
    tested = np.flatnonzero(np.isfinite(raw))
    order = tested[np.argsort(raw[tested], kind="stable")]
    adjusted[order] = np.minimum(step(raw[order]), 1.0)
    return adjusted
