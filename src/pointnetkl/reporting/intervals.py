"""Statistics of values that come in draws: within a draw they share their luck, so only draws count as independent.

One hundred noises on one graph share that graph's loop-closure errors: an interval over them is of another noise on
this graph, and not of another survey like it.
"""

import numpy as np
from scipy import stats

FEWEST = 3  # draws, below which their spread says nothing


def means(values: np.ndarray, draw: np.ndarray) -> np.ndarray:
    """Return the mean of the values (n,) of each draw, given every value's draw (n,)."""
    _, place = np.unique(draw, return_inverse=True)
    return np.asarray(np.bincount(place, values) / np.bincount(place))


def interval(values: np.ndarray, draw: np.ndarray) -> tuple[float, float] | None:
    """Return the 95 % t interval of the mean over draws; None of few draws, or where they do not differ."""
    each = means(values, draw)
    if not _tell(each):
        return None
    low, high = stats.t.interval(0.95, len(each) - 1, each.mean(), stats.sem(each))
    return float(low), float(high)


def p_below(differences: np.ndarray, draw: np.ndarray) -> float | None:
    """Return the p-value of a t test over draws that the mean difference is below zero, against that it is not."""
    each = means(differences, draw)
    return float(stats.ttest_1samp(each, 0.0, alternative="less").pvalue) if _tell(each) else None


def _tell(each: np.ndarray) -> bool:
    return len(each) >= FEWEST and bool(np.isfinite(each).all()) and each.std() > 1e-12 * np.abs(each).max()
