"""Zero-mean Gaussians by their covariances: divergence, axes, how well they describe errors, and a check."""

import numpy as np
from scipy import special

from pointnetkl.workflow.errors import PointNetKLError

COVERAGES = (0.50, 0.90, 0.95, 0.99)
# Added to label and estimate alike where a KL is judged, m^2. report.kl_floor_m2 has the same value, and is read by the
# report alone: otherwise a change of the report would train every model again.
KL_FLOOR_M2 = 0.01
_ROUND = 1e-9  # anisotropy below this is rounding


class CovarianceError(PointNetKLError):
    """A matrix is not a covariance, or covariances do not belong to the errors beside them."""


def kl_divergence(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return KL(N(0, p) || N(0, q)) in nats (Eq. 9 of the paper with zero means), for (..., M, M) stacks."""
    # slogdet, because the determinant of a small covariance underflows
    log_ratio = np.linalg.slogdet(q)[1] - np.linalg.slogdet(p)[1]
    trace = np.trace(np.linalg.solve(q, p), axis1=-2, axis2=-1)
    return np.asarray(0.5 * (trace - p.shape[-1] + log_ratio))


def with_floor(q: np.ndarray, floor: float) -> np.ndarray:
    """Return q (..., M, M) + floor I, m^2: what KL goals are judged on, for label and estimate alike.

    A yaw (M = 3) gets floor / (100 m)^2, what the floor is at 100 m, the order of a swath.
    """
    share = np.array([1.0, 1.0, 1e-4])[: q.shape[-1]]
    return np.asarray(q + floor * np.diag(share))


def divergence(labels: np.ndarray, q: np.ndarray, floor: float) -> np.ndarray:
    """Return KL(label || Q) (n,) in nats of covariances (n, M, M); `floor` in m^2 is added to both."""
    return kl_divergence(with_floor(labels, floor), with_floor(q, floor))


def check(q: np.ndarray, origin: str) -> np.ndarray:
    """Return q, an (M, M) covariance, if it is one.

    Raises:
        CovarianceError: an entry is not finite, or q is not symmetric or not positive definite.
    """
    if not np.isfinite(q).all():
        raise CovarianceError(f"{origin}: the covariance has an entry that is not a number; drop the submap")
    # against the largest entry, because rounding leaves more than that of an off-diagonal near zero
    if np.abs(q - q.T).max() > 1e-9 * np.abs(q).max():
        raise CovarianceError(f"{origin}: the covariance is not symmetric: {q.tolist()}")
    if (smallest := float(np.linalg.eigvalsh(q)[0])) <= 0:
        raise CovarianceError(
            f"{origin}: smallest eigenvalue of the covariance is {smallest:.3g} m^2, must be positive;"
            " raise the number of registrations or drop the submap"
        )
    return q


def axis_error(labels: np.ndarray, q: np.ndarray) -> float:
    """Return the mean angle, radians from 0 to pi/2, between the major axes in x, y of labels and q (n, M, M).

    The weight of a label is its anisotropy (a - b) / (a + b), a and b the eigenvalues in x, y: a round label has no
    axis to miss. A round q has no axis to compare, and counts as pi/4, the mean error of a guess. The result is NaN
    where all labels are round.
    """
    true, estimated = _elongation(labels), _elongation(q)
    angle = np.abs(np.angle(estimated * true.conj())) / 2
    weight = np.abs(true)
    total = weight.sum()
    if not total > 0:
        return float("nan")
    return float(weight @ np.where(np.abs(estimated) > _ROUND, angle, np.pi / 4) / total)


def _elongation(q: np.ndarray) -> np.ndarray:
    """Return a complex number (n,) of each q: its anisotropy in x, y, turned by twice its major axis's angle."""
    xx, xy, yy = q[:, 0, 0], q[:, 0, 1], q[:, 1, 1]
    return np.asarray((xx - yy + 2j * xy) / (xx + yy))


def squared_mahalanobis(errors: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return e^T Q^-1 e (n, L) of errors (n, L, M) under covariances (n, M, M)."""
    whitened = np.linalg.solve(np.linalg.cholesky(q), np.swapaxes(errors, 1, 2).astype(np.float64))
    return np.asarray((whitened**2).sum(axis=1))


def log_likelihood(errors: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return log N(e; 0, q) (n, L) in nats of errors (n, L, M) under covariances (n, M, M): more is better.

    The unit of a density is that of the errors: differences between covariances of the same errors mean something.
    """
    log_volume = np.linalg.slogdet(2 * np.pi * q)[1]
    return np.asarray(-0.5 * (squared_mahalanobis(errors, q) + log_volume[:, None]))


def calibration(errors: np.ndarray, q: np.ndarray, floor: float = 0.0) -> dict[str, float]:
    """Return how well covariances q (n, M, M) describe errors (n, L, M) in metres; `floor` is added to q.

    `nees` is the mean of e^T Q^-1 e / M: 1 is right, more is overconfident. `coverage_95` is the share of errors
    inside the ellipse that holds 95 % of a Gaussian's; `coverage_50`, `_90` and `_99` likewise.

    Raises:
        CovarianceError: there are no errors, or not one covariance for each row of them.
    """
    if errors.size == 0 or len(errors) != len(q):
        raise CovarianceError(f"errors of shape {errors.shape} cannot be judged by {len(q)} covariances")
    m = errors.shape[-1]
    d2 = squared_mahalanobis(errors, with_floor(q, floor))
    bounds = 2 * special.gammaincinv(m / 2, COVERAGES)  # quantiles of chi-squared, without the second of scipy.stats
    inside = {f"coverage_{round(100 * c)}": float(np.mean(d2 <= b)) for c, b in zip(COVERAGES, bounds, strict=True)}
    return {"nees": float(d2.mean() / m), **inside}
