"""What estimates are judged by: trajectory error, divergence, NEES and coverage, and intervals by bootstrap."""

import numpy as np
from scipy import stats

from pointnetkl.covariance import gaussian
from pointnetkl.errors import PointNetKLError

COVERAGES = (0.50, 0.90, 0.95, 0.99)
_DRAWS = 2000  # of the bootstrap


class MetricsError(PointNetKLError):
    """A measure of nothing, or of things that do not belong together."""


def rmse(estimate: np.ndarray, reference: np.ndarray) -> float:
    """Return sqrt(mean |d|^2) over positions (n, 2 or 3), unaligned; NaN where the reference is unknown."""
    return float(np.sqrt(np.mean(np.sum((estimate - reference) ** 2, axis=1))))


def align_se2(estimate: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return positions (n, 3) turned about z and moved in x, y to lie closest to the reference (n, 3)."""
    a, b = estimate[:, :2], reference[:, :2]
    centred, goal = a - a.mean(axis=0), b - b.mean(axis=0)
    cross = centred.T @ goal
    # the rotation that maximises the trace of R cross: in the plane, one arctangent
    angle = np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1])
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([centred @ R.T + b.mean(axis=0), estimate[:, 2]])


def mean_ci95(values: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % bootstrap interval (percentiles) of the mean of values (n,).

    Raises:
        MetricsError: there are no values.
    """
    if len(values) == 0:
        raise MetricsError("an interval of no values was asked for; there must be at least one")
    means = [rng.choice(values, len(values)).mean() for _ in range(_DRAWS)]
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def kl_summary(
    labels: np.ndarray, q: np.ndarray, floor: float, rng: np.random.Generator
) -> dict[str, float | list[float]]:
    """Summarise KL(label || Q) in nats over covariances (n, 2, 2); `floor` in m^2 is added to both.

    Returns mean, median, ci95 (of the mean, by bootstrap over submaps) and mean_floor0, without the floor.
    """
    kl = gaussian.kl_divergence(gaussian.with_floor(labels, floor), gaussian.with_floor(q, floor))
    return {
        "mean": float(kl.mean()),
        "median": float(np.median(kl)),
        "ci95": list(mean_ci95(kl, rng)),
        "mean_floor0": float(gaussian.kl_divergence(labels, q).mean()),
    }


def squared_mahalanobis(errors: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return e^T Q^-1 e (n, L) of errors (n, L, M) under covariances (n, M, M)."""
    whitened = np.linalg.solve(np.linalg.cholesky(q), np.swapaxes(errors, 1, 2).astype(np.float64))
    return np.asarray((whitened**2).sum(axis=1))


def calibration(errors: np.ndarray, q: np.ndarray, floor: float = 0.0) -> dict[str, float]:
    """Return how well covariances q (n, M, M) describe errors (n, L, M) in metres; `floor` is added to q.

    `nees` is the mean of e^T Q^-1 e / M: 1 is right, more is overconfident. `coverage_95` is the share of
    errors inside the ellipse that a Gaussian would leave in 5 % of cases; and so for 50, 90 and 99.

    Raises:
        MetricsError: there are no errors, or not one covariance for each row of them.
    """
    if errors.size == 0 or len(errors) != len(q):
        raise MetricsError(f"errors of shape {errors.shape} cannot be judged by {len(q)} covariances")
    d2 = squared_mahalanobis(errors, gaussian.with_floor(q, floor))
    bounds = stats.chi2.ppf(COVERAGES, errors.shape[-1])
    inside = {f"coverage_{round(100 * c)}": float(np.mean(d2 <= b)) for c, b in zip(COVERAGES, bounds, strict=True)}
    return {"nees": float(d2.mean() / errors.shape[-1]), **inside}
