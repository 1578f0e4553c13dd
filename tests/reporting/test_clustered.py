"""Statistics of draws: what shares its luck counts once."""

import numpy as np
import pytest
from scipy import stats

from pointnetkl.reporting import intervals

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
