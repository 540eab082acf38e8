"""Statistics against hand-computed cases, a second implementation, and simulated data."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import rankdata
from statsmodels.stats.multitest import multipletests

from reports.statistics import (
    Clusters,
    Resamples,
    benjamini_hochberg,
    compare,
    geometric_mean_ratio,
    holm,
    interval,
    rank_biserial,
    wilcoxon,
    win_rate,
)

P_VALUES = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20)


@settings(max_examples=50, deadline=None)
@given(P_VALUES)
def test_corrections_agree_with_statsmodels(p: list[float]) -> None:
    np.testing.assert_allclose(holm(p), multipletests(p, method="holm")[1], atol=1e-12)
    np.testing.assert_allclose(benjamini_hochberg(p), multipletests(p, method="fdr_bh")[1], atol=1e-12)


def test_holm_by_hand_and_an_untested_member_does_not_count() -> None:
    np.testing.assert_allclose(holm([0.01, np.nan, 0.04, 0.03]), [0.03, np.nan, 0.06, 0.06])


def test_wilcoxon_by_counting_all_signs() -> None:
    """Exact p: the share of the 2^m sign patterns with a rank sum at least as extreme."""
    difference = np.array([1.0, -2.0, 3.0, 4.0, 5.5, -6.0, 7.0])
    ranks = rankdata(np.abs(difference))
    observed = abs(np.sum(np.sign(difference) * ranks))
    sums = [abs(np.dot(signs, ranks)) for signs in itertools.product([-1, 1], repeat=len(ranks))]
    assert wilcoxon(difference, np.zeros(7)) == pytest.approx(np.mean(np.array(sums) >= observed))


def test_wilcoxon_of_equal_values_finds_nothing() -> None:
    assert wilcoxon([1.0, 2.0], [1.0, 2.0]) == 1.0
    assert np.isnan(wilcoxon([], []))


def test_rank_biserial_by_hand() -> None:
    assert rank_biserial([1, 1, 1], [2, 3, 4]) == -1.0
    assert rank_biserial([3, 1, 4], [2, 4, 2]) == pytest.approx((1 - 3 + 2) / 6)  # ranks 1, 3, 2
    assert rank_biserial([1, 2], [1, 2]) == 0.0


def test_win_rate_counts_ties_half() -> None:
    assert win_rate([1, 2, 3, 5], [2, 2, 1, 6]) == pytest.approx((1 + 0.5 + 0 + 1) / 4)


def test_geometric_mean_ratio() -> None:
    assert geometric_mean_ratio([1, 8], [2, 2]) == pytest.approx(np.sqrt(0.5 * 4))
    assert np.isnan(geometric_mean_ratio([0.0, 1.0], [1.0, 1.0]))


def test_pair_and_target_means_by_hand() -> None:
    clusters = Clusters.of(["a", "a", "b", "c"], ["b", "b", "a", "a"])  # pairs ab, ba, ca
    pairs = clusters.pair_means(np.array([1.0, 3.0, 5.0, 9.0]))
    np.testing.assert_allclose(pairs, [2.0, 5.0, 9.0])
    np.testing.assert_allclose(clusters.target_means(pairs), [7.0, 2.0])  # targets a, b
    assert (clusters.count, clusters.identities) == (3, 2)


def _grid(identities: int, draws: int) -> Clusters:
    cells = [(s, t) for s, t in itertools.permutations(range(identities), 2) for _ in range(draws)]
    return Clusters.of([f"{s:02d}" for s, _ in cells], [f"{t:02d}" for _, t in cells])


def test_resamples_weigh_to_one_and_repeat() -> None:
    clusters = _grid(5, 3)
    one, two = Resamples.of(clusters, 1, 200), Resamples.of(clusters, 1, 200)
    np.testing.assert_allclose(one.pairs.sum(axis=1), 1.0)
    np.testing.assert_array_equal(one.pairs, two.pairs)
    np.testing.assert_allclose(one.means(np.ones((len(clusters.pair), 2))), 1.0)
    np.testing.assert_allclose(one.log_ratios(np.full(60, 2.0), np.ones(60)), np.log(2.0))


def test_draws_are_resampled() -> None:
    """Two identities and one direction: only the draws can vary."""
    clusters = Clusters.of(["a"] * 4, ["b"] * 4)
    low, high = interval(Resamples.of(clusters, 0).means(np.array([[0.0], [0.0], [1.0], [1.0]])))
    assert 0.0 <= low[0] < 0.2
    assert 0.8 < high[0] <= 1.0


def test_interval_covers_the_truth_when_people_vary() -> None:
    """Simulated sources, targets, pairs and draws: nominal 95 %, a bootstrap of 10 people may fall a little short.

    An interval that takes the pairs as independent covers far less often.
    """
    rng = np.random.default_rng(5)
    people, draws, rounds = 10, 3, 150
    clusters = _grid(people, draws)
    resamples = Resamples.of(clusters, 0, 600)
    people_effects = rng.normal(size=(rounds, 2, people)) * np.array([0.5, 1.0])[:, None]
    pair_effects = 0.3 * rng.normal(size=(rounds, clusters.count))
    values = people_effects[:, 0, clusters.sources] + people_effects[:, 1, clusters.targets] + pair_effects
    cells = values[:, clusters.pair] + 0.2 * rng.normal(size=(rounds, len(clusters.pair)))
    low, high = interval(resamples.means(cells.T))
    assert 0.86 <= np.mean((low <= 0) & (high >= 0)) <= 0.99
    pairs = clusters.pair_means(cells.T)
    naive = 1.96 * pairs.std(axis=0, ddof=1) / np.sqrt(clusters.count)
    assert np.mean(np.abs(pairs.mean(axis=0)) <= naive) < 0.75


def test_interval_of_a_ratio_narrows_with_people() -> None:
    rng = np.random.default_rng(1)
    widths = []
    for people in (5, 20):
        clusters = _grid(people, 2)
        cells = np.exp(0.3 * rng.normal(size=people)[clusters.targets][clusters.pair])
        low, high = interval(Resamples.of(clusters, 0, 800).log_ratios(cells, np.ones(len(cells))))
        widths.append(float(high - low))
    assert widths[1] < 0.75 * widths[0]


def test_below_four_identities_nothing_is_testable() -> None:
    rng = np.random.default_rng(0)
    for people, testable in ((3, False), (4, True)):
        clusters = _grid(people, 2)
        values = rng.random(len(clusters.pair)) + 1
        found = compare(values, values + 0.5, Resamples.of(clusters, 0, 50), values, values + 0.5)
        assert np.isfinite([found.p, found.p_targets, found.p_naive]).all() == testable
        assert found.win_rate == 1.0
        assert found.effect == -1.0
        assert found.ratio_low < found.ratio < 1.0
