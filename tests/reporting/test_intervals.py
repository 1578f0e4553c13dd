"""Intervals and tests: draws count, not the values within one; a bootstrap of neighbours is wider."""

import numpy as np
import pytest
from scipy import stats

from pointnetkl.reporting import intervals

RNG = np.random.default_rng(0)
Q = np.array([[[2.0, 0.8], [0.8, 0.5]], [[0.01, 0.0], [0.0, 9.0]]])
DRAW = np.repeat(np.arange(6), 20)


def sample(rng: np.random.Generator, mean: float = 0.0) -> np.ndarray:
    """Return 120 values of 6 draws, with as much spread between draws as within one."""
    return mean + rng.normal(size=6)[DRAW] + rng.normal(size=len(DRAW))


def test_the_mean_of_each_draw_is_one_value():
    assert intervals.means(np.array([1.0, 3.0, 10.0]), np.array([4, 4, 9])).tolist() == [2.0, 10.0]


def test_the_interval_covers_where_one_that_ignores_draws_does_not():
    rng, right, naive = np.random.default_rng(0), 0, 0
    for _ in range(400):
        values = sample(rng)
        low, high = intervals.interval(values, DRAW)
        right += low < 0 < high
        low, high = stats.t.interval(0.95, len(values) - 1, values.mean(), stats.sem(values))
        naive += low < 0 < high
    assert 0.92 < right / 400 < 0.98
    assert naive / 400 < 0.6


def test_the_test_errs_as_often_as_it_says_where_there_is_no_difference():
    rng = np.random.default_rng(1)
    p = np.array([intervals.p_below(sample(rng), DRAW) for _ in range(400)])
    assert 0.02 < np.mean(p < 0.05) < 0.09
    assert 0.4 < p.mean() < 0.6


def test_the_test_finds_what_is_lower_and_only_that():
    rng = np.random.default_rng(2)
    assert intervals.p_below(sample(rng, -5.0), DRAW) < 1e-3
    assert intervals.p_below(sample(rng, 5.0), DRAW) > 0.99


@pytest.mark.parametrize("values", [np.arange(4.0), np.full(6, 2.5), np.zeros(6), np.full(6, np.nan), np.empty(0)])
def test_few_draws_or_equal_ones_tell_nothing(values: np.ndarray):
    draw = np.arange(len(values)) if len(values) == 6 else np.arange(len(values)) % 2
    assert intervals.interval(values, draw) is None
    assert intervals.p_below(values, draw) is None


def draws(count: int, block: int = 1) -> np.ndarray:
    return intervals.resamples(count, np.random.default_rng(1), block)


def test_the_interval_of_a_mean_holds_the_mean_and_narrows_with_more_values():
    values = RNG.normal(size=400)
    low, high = intervals.mean_ci95(values, draws(400))
    few = intervals.mean_ci95(values[:40], draws(40))
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert few[1] - few[0] > high - low


def test_an_interval_of_nothing_is_refused():
    with pytest.raises(intervals.IntervalError):
        draws(0)


def test_drawing_neighbours_together_widens_the_interval_of_values_that_they_share():
    shared = np.repeat(RNG.normal(size=60), 5)
    (low, high), (low_alone, high_alone) = (intervals.mean_ci95(shared, draws(300, block)) for block in (10, 1))
    assert high - low > 1.7 * (high_alone - low_alone)
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(60), rel=0.3)


@pytest.mark.parametrize(("count", "block"), [(1, 5), (2, 5), (7, 5), (50, 5), (50, 1000)])
def test_every_draw_has_as_many_values_as_there_are_and_draws_differ(count: int, block: int):
    which = draws(count, block)
    assert which.shape[1] == count
    assert (which.min(), which.max()) == (0, count - 1)
    assert count == 1 or len(np.unique(np.sort(which, axis=1), axis=0)) > 1


def test_of_two_alike_neither_is_better_in_more_than_about_half_of_the_draws():
    values, noise = RNG.normal(size=200), RNG.normal(size=200)
    assert intervals.share_better(values - 0.5, values, draws(200)) == 1.0
    assert intervals.share_better(values + noise - noise.mean(), values, draws(200)) == pytest.approx(0.5, abs=0.1)


def test_pairs_tell_methods_apart_whose_intervals_overlap():
    values = 5 * RNG.normal(size=50) ** 2
    (_, high), (low, _) = (intervals.mean_ci95(means, draws(50)) for means in (values, values + 0.1))
    assert high > low
    assert intervals.share_better(values, values + 0.1, draws(50)) == 1.0


def test_a_label_diverges_from_itself_by_nothing():
    summary = intervals.kl_summary(np.repeat(Q, 5, axis=0), np.repeat(Q, 5, axis=0), 0.01, draws(10))
    numbers = [summary[name] for name in ("mean", "median", "mean_floor0", "axis_error_deg")]
    assert numbers == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=1e-9)
    assert summary["ci95"] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_of_few_submaps_there_is_no_interval():
    assert intervals.kl_summary(Q, 2 * Q, 0.01, draws(2))["ci95"] is None


def test_the_floor_softens_the_divergence_of_tiny_labels():
    label, q = 1e-5 * np.eye(2)[None], 1e-2 * np.eye(2)[None]
    summary = intervals.kl_summary(label, q, 0.01, draws(1))
    assert summary["mean"] < 0.2 < summary["mean_floor0"]


def test_an_interval_of_clustered_values_covers_though_clusters_have_other_sizes():
    rng, right = np.random.default_rng(0), 0
    cluster = np.repeat(np.arange(30), rng.integers(2, 12, 30))
    for _ in range(400):
        values = rng.normal(size=30)[cluster] + rng.normal(size=len(cluster))
        low, high = intervals.clustered(values, cluster)
        right += low < 0 < high
    assert 0.92 < right / 400 < 0.98


@pytest.mark.parametrize("values", [np.arange(4.0), np.full(6, 2.7), np.zeros(6), np.full(6, np.nan), np.empty(0)])
def test_few_clusters_or_equal_ones_have_no_interval(values: np.ndarray):
    cluster = np.arange(len(values)) if len(values) == 6 else np.arange(len(values)) % 2
    assert intervals.clustered(values, cluster) is None
