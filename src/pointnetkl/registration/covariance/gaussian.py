"""Zero-mean Gaussians by their covariances: divergence, and the check that a covariance is one."""

import numpy as np

from pointnetkl.workflow.errors import PointNetKLError


class CovarianceError(PointNetKLError):
    """A matrix is not a covariance."""


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
