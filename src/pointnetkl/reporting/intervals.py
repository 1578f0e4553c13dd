"""Intervals and tests: by bootstrap over submaps, and by t over draws of a survey's loop closures.

Values of one draw are not independent: one hundred noises on one graph share that graph's loop-closure errors. An
interval over them would be of another noise on this graph, and not of another survey like it. So t counts draws.
"""

import zlib

import numpy as np
from scipy import stats

from pointnetkl.registration.covariance import gaussian
from pointnetkl.workflow.errors import PointNetKLError

FEWEST = 5  # values of a bootstrap: of fewer an interval would say nothing
_FEWEST_DRAWS = 3  # below which their spread says nothing
_DRAWS = 2000  # of the bootstrap


class IntervalError(PointNetKLError):
    """There is nothing to draw an interval from."""


def rng(seed: int, *names: str) -> np.random.Generator:
    """Return a generator for these names, so that an interval does not change when another method or survey joins."""
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])


def means(values: np.ndarray, draw: np.ndarray) -> np.ndarray:
    """Return the mean of the values (n,) of each draw, given every value's draw (n,)."""
    _, place = np.unique(draw, return_inverse=True)
    return np.asarray(np.bincount(place, values) / np.bincount(place))


def interval(values: np.ndarray, draw: np.ndarray) -> tuple[float, float] | None:
    """Return the 95 % t interval of the mean over draws; None of few draws, or where they do not differ."""
    by_draw = means(values, draw)
    if not _differ(by_draw):
        return None
    low, high = stats.t.interval(0.95, len(by_draw) - 1, by_draw.mean(), stats.sem(by_draw))
    return float(low), float(high)


def clustered(values: np.ndarray, cluster: np.ndarray) -> tuple[float, float] | None:
    """Return the 95 % t interval of the mean of values (n,), of which those of one cluster (n,) are not independent.

    The variance is that of the clusters' sums (Liang and Zeger, Biometrika 73, 1986), with one degree of freedom less
    than clusters. None of few clusters, or where they do not differ.
    """
    _, place = np.unique(cluster, return_inverse=True)
    sums = np.bincount(place, values - values.mean()) if len(values) else np.empty(0)
    count = len(sums)
    if count < _FEWEST_DRAWS or not np.isfinite(sums).all() or np.abs(sums).max() <= 1e-12 * np.abs(values).sum():
        return None
    error = np.sqrt(count / (count - 1) * (sums**2).sum()) / len(values)
    low, high = stats.t.interval(0.95, count - 1, values.mean(), error)
    return float(low), float(high)


def p_below(differences: np.ndarray, draw: np.ndarray) -> float | None:
    """Return the p-value of a t test over draws that the mean difference is below zero, against that it is not."""
    by_draw = means(differences, draw)
    return float(stats.ttest_1samp(by_draw, 0.0, alternative="less").pvalue) if _differ(by_draw) else None


def _differ(by_draw: np.ndarray) -> bool:
    enough = len(by_draw) >= _FEWEST_DRAWS and bool(np.isfinite(by_draw).all())
    return enough and by_draw.std() > 1e-12 * np.abs(by_draw).max()


def resamples(count: int, rng: np.random.Generator, block: int = 1) -> np.ndarray:
    """Return the indices (draws, count) of the values, of `count`, that each draw of a bootstrap takes.

    Values are taken in runs of `block` neighbours, the first after the last, because neighbours may be alike. A run is
    at most a quarter of the values, or every draw would hold the same ones.

    Raises:
        IntervalError: there are no values.
    """
    if count == 0:
        raise IntervalError("an interval of no values was asked for; there must be at least one")
    length = max(1, min(block, count // 4))
    starts = rng.integers(count, size=(_DRAWS, -(-count // length)))
    runs = (starts[:, :, None] + np.arange(length)) % count
    return runs.reshape(_DRAWS, -1)[:, :count]


def mean_ci95(values: np.ndarray, draws: np.ndarray) -> tuple[float, float]:
    """Return the 95 % bootstrap interval (percentiles) of the mean of values (n,); `draws` are resamples."""
    low, high = np.percentile(values[draws].mean(axis=1), [2.5, 97.5])
    return float(low), float(high)


def share_better(values: np.ndarray, rivals: np.ndarray, draws: np.ndarray) -> float:
    """Return the share of draws in which the mean of values (n,) is below that of rivals (n,) of the same submaps."""
    return float(np.mean((values - rivals)[draws].mean(axis=1) < 0))


def kl_summary(
    labels: np.ndarray, q: np.ndarray, floor: float, draws: np.ndarray
) -> dict[str, float | tuple[float, float] | None]:
    """Summarise how far covariances q are from labels, both (n, M, M); `floor` in m^2 is added to both.

    Returns mean, median and ci95 (of the mean, by the bootstrap's `draws`; None of few values) of KL(label || Q) in
    nats, mean_floor0, without the floor, and axis_error_deg (`gaussian.axis_error`).
    """
    kl = gaussian.divergence(labels, q, floor)
    return {
        "mean": float(kl.mean()),
        "median": float(np.median(kl)),
        "ci95": mean_ci95(kl, draws) if len(kl) >= FEWEST else None,
        "mean_floor0": float(gaussian.divergence(labels, q, 0.0).mean()),
        "axis_error_deg": float(np.rad2deg(gaussian.axis_error(gaussian.with_floor(labels, floor), q))),
    }
