"""Poses from navigation and loop closures, in covariance form: least squares, and graduated non-convexity.

The covariance of navigation is dense and may be next to singular (two poses share nearly all of their error), so it is
never inverted. With C of navigation's poses x0, slopes J and residuals r of the closures,

    x = x0 - C J^T (J C J^T + W^-1)^-1 (r + J (x0 - x)),    covariance C - C J^T (J C J^T + W^-1)^-1 J C,

which is what Gauss and Newton find with C^-1. It needs one system as large as the closures' rows.
"""

from collections.abc import Sequence

import numpy as np
from scipy import linalg, stats

from pointnetkl.slam.closing.estimate import ClosingError, Closure, Estimate, linearised

_STEPS = 30
_STEADY = 1e-5  # metres and radians
_LEAST_WEIGHT = 1e-9  # a closure of less counts as refused
_MOST_PROBLEMS = 100  # of graduated non-convexity; it doubles a number of some 1e-3 until all weights are 0 or 1


def solve(navigation: Estimate, closures: Sequence[Closure], weights: np.ndarray | None = None) -> Estimate:
    """Return the most likely poses and their covariance.

    Args:
        navigation: the poses before any closure.
        closures: k of them; of rank 0 they change nothing.
        weights: (k,) from 0 to 1, which multiply squared residuals; None: 1.

    Raises:
        ClosingError: the search does not settle.
    """
    kept = np.ones(len(closures)) if weights is None else weights
    used = [closure for closure, weight in zip(closures, kept, strict=True) if weight > _LEAST_WEIGHT]
    noise = np.repeat(1 / kept[kept > _LEAST_WEIGHT], [closure.rank for closure in used])
    x, C = navigation.poses, navigation.covariance
    if not len(noise):
        return navigation
    for _ in range(_STEPS):
        J, r = linearised(used, x)
        CJ = np.asarray((J @ C).T)
        factor = linalg.cho_factor(J @ CJ + np.diag(noise))
        gain = CJ @ linalg.cho_solve(factor, r + J @ (navigation.poses - x).ravel())
        last, x = x, navigation.poses - gain.reshape(-1, 3)
        if np.abs(x - last).max() < _STEADY:
            covariance = C - CJ @ linalg.cho_solve(factor, CJ.T)
            return Estimate(x, (covariance + covariance.T) / 2)
    raise ClosingError(
        f"{len(used)} loop closures and navigation of {len(x)} submaps have no solution: steps do not become small;"
        " look for rates of drift that are far too large"
    )


def variance_factor(navigation: Estimate, closures: Sequence[Closure]) -> float:
    """Return how large the closures' residuals at navigation's poses are, squared, for what they should be.

    It is the median of the squares of L^-1 r, with L L^T = J C J^T + I, over that of chi2 of one degree, so that wrong
    closures hardly move it: 1 where drift and closures are as sure as they say, 9 where drift is three times as large.
    NaN without closures.
    """
    J, r = linearised(closures, navigation.poses)
    if not len(r):
        return float("nan")
    S = J @ np.asarray((J @ navigation.covariance).T) + np.eye(len(r))
    whitened = linalg.solve_triangular(np.linalg.cholesky(S), r, lower=True)
    return float(np.median(whitened**2) / stats.chi2.median(1))


def updated(estimate: Estimate, closure: Closure) -> Estimate:
    """Return an estimate with one more closure, at its linearisation: for the next one's start, `solve` settles it.

    The covariance is changed in place, because a copy for every closure of a long survey would take most of the time.
    """
    columns, J = closure.tie.jacobian(estimate.poses)
    slopes = closure.A @ J
    CJ = estimate.covariance[:, columns] @ slopes.T
    L = np.linalg.cholesky(slopes @ CJ[columns] + np.eye(closure.rank))
    # a square is symmetric to the last digit; from C - gain J C asymmetry would grow threefold with every closure
    half = linalg.solve_triangular(L, CJ.T, lower=True)
    step = half.T @ linalg.solve_triangular(L, closure.residual(estimate.poses), lower=True)
    # BLAS has columns first: the transpose of a symmetric matrix is itself, and is not copied
    square = linalg.blas.dgemm(-1.0, half, half, 1.0, estimate.covariance.T, trans_a=True, overwrite_c=True)
    return Estimate(estimate.poses - step.reshape(-1, 3), square.T)


def graduated(
    navigation: Estimate, closures: Sequence[Closure], probability: float, step: float
) -> tuple[Estimate, np.ndarray]:
    """Return the poses, and each closure's weight (k,), by truncated least squares with graduated non-convexity.

    A closure counts as false where its squared residual is above the `probability` quantile of chi2 of its rank.
    Yang et al., "Graduated non-convexity for robust spatial perception", RA-L 2020, whose control parameter `step`
    multiplies from problem to problem.

    Raises:
        ClosingError: as solve.
    """
    limits = np.array([stats.chi2.ppf(probability, max(closure.rank, 1)) for closure in closures])
    weights = np.ones(len(closures))
    solved = solve(navigation, closures)
    ratios = _squares(closures, solved.poses) / limits
    if not len(ratios) or ratios.max() <= 1:
        return solved, weights
    mu = 1 / (2 * ratios.max() - 1)
    for _ in range(_MOST_PROBLEMS):
        weights = _weights(ratios, mu)
        solved = solve(navigation, closures, weights)
        ratios = _squares(closures, solved.poses) / limits
        if ((weights == 0) | (weights == 1)).all():
            break
        mu *= step
    weights = (weights > 0.5).astype(float)
    return solve(navigation, closures, weights), weights


def _squares(closures: Sequence[Closure], poses: np.ndarray) -> np.ndarray:
    return np.array([float(np.sum(closure.residual(poses) ** 2)) for closure in closures])


def _weights(ratios: np.ndarray, mu: float) -> np.ndarray:
    # Eq. 14 of the paper, with squared residuals by their limit
    between = np.sqrt(mu * (mu + 1) / np.maximum(ratios, 1e-12)) - mu
    return np.where(ratios >= (mu + 1) / mu, 0.0, np.where(ratios <= mu / (mu + 1), 1.0, np.clip(between, 0.0, 1.0)))
