"""What estimates are judged by: trajectory error, divergence, axes, NEES and coverage, and intervals by bootstrap."""

import numpy as np
from scipy import stats

from pointnetkl.registration.covariance import gaussian
from pointnetkl.workflow.errors import PointNetKLError

COVERAGES = (0.50, 0.90, 0.95, 0.99)
FEWEST = 5  # values that an interval is drawn from: of fewer it would tell nothing
_DRAWS = 2000  # of the bootstrap
_ROUND = 1e-9  # less anisotropy than this is rounding


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


def align_4dof(estimate: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return positions (n, 3) turned about z and moved in x, y and z to lie closest to the reference (n, 3)."""
    turned = align_se2(estimate, reference)
    turned[:, 2] += np.mean(reference[:, 2] - estimate[:, 2])
    return turned


def resamples(count: int, rng: np.random.Generator, block: int = 1) -> np.ndarray:
    """Return which of `count` values each draw of a bootstrap takes, (draws, count) indices.

    Values are taken in runs of `block` neighbours, the first after the last, because neighbours may tell the same; a
    run is at most a quarter of the values, or every draw would hold the same ones.

    Raises:
        MetricsError: there are no values.
    """
    if count == 0:
        raise MetricsError("an interval of no values was asked for; there must be at least one")
    length = max(1, min(block, count // 4))
    starts = rng.integers(count, size=(_DRAWS, -(-count // length)))
    runs = (starts[:, :, None] + np.arange(length)) % count
    return runs.reshape(_DRAWS, -1)[:, :count]


def mean_ci95(values: np.ndarray, draws: np.ndarray) -> tuple[float, float]:
    """Return the 95 % bootstrap interval (percentiles) of the mean of values (n,); `draws` are resamples."""
    low, high = np.percentile(values[draws].mean(axis=1), [2.5, 97.5])
    return float(low), float(high)


def share_better(values: np.ndarray, rivals: np.ndarray, draws: np.ndarray) -> float:
    """Return the share of draws in which the mean of values (n,) is below that of rivals (n,) of the same things."""
    return float(np.mean((values - rivals)[draws].mean(axis=1) < 0))


def divergence(labels: np.ndarray, q: np.ndarray, floor: float) -> np.ndarray:
    """Return KL(label || Q) (n,) in nats of covariances (n, M, M); `floor` in m^2 is added to both."""
    return gaussian.kl_divergence(gaussian.with_floor(labels, floor), gaussian.with_floor(q, floor))


def kl_summary(
    labels: np.ndarray, q: np.ndarray, floor: float, draws: np.ndarray
) -> dict[str, float | tuple[float, float] | None]:
    """Summarise how far covariances q are from labels, both (n, M, M); `floor` in m^2 is added to both.

    Returns mean, median and ci95 (of the mean, by the bootstrap's `draws`; None of few) of KL(label || Q) in nats,
    mean_floor0, without the floor, and axis_error_deg (`axis_error`).
    """
    kl = divergence(labels, q, floor)
    return {
        "mean": float(kl.mean()),
        "median": float(np.median(kl)),
        "ci95": mean_ci95(kl, draws) if len(kl) >= FEWEST else None,
        "mean_floor0": float(divergence(labels, q, 0.0).mean()),
        "axis_error_deg": float(np.rad2deg(axis_error(gaussian.with_floor(labels, floor), q))),
    }


def axis_error(labels: np.ndarray, q: np.ndarray) -> float:
    """Return the mean angle, radians from 0 to pi/2, between the major axes in x, y of labels and q (n, M, M).

    Each counts by its label's anisotropy (a - b) / (a + b), a and b the eigenvalues in x, y: a round label has no axis
    to miss. A round q has none to compare: pi/4, what a guess misses by on average. NaN where all labels are round.
    """
    wanted, given = _elongation(labels), _elongation(q)
    between = np.abs(np.angle(given * wanted.conj())) / 2
    weight = np.abs(wanted)
    total = weight.sum()
    if not total > 0:
        return float("nan")
    return float(weight @ np.where(np.abs(given) > _ROUND, between, np.pi / 4) / total)


def _elongation(q: np.ndarray) -> np.ndarray:
    """Return a complex number (n,) of each q: its anisotropy in x, y, turned by twice its major axis's angle."""
    xx, xy, yy = q[:, 0, 0], q[:, 0, 1], q[:, 1, 1]
    return np.asarray((xx - yy + 2j * xy) / (xx + yy))


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
