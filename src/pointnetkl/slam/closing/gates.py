"""What a loop closure must pass: residuals like the survey's others, and a place that drift can explain."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from pointnetkl.registration.pair import factor
from pointnetkl.slam.closing.estimate import Closure, Estimate, linearised


def by_residuals(closures: Sequence[Closure], settings: factor.Settings) -> np.ndarray:
    """Return whether (k,) residual variances are at most largest_variance_ratio times their median."""
    variances = np.array([closure.residual_variance for closure in closures])
    return (
        np.asarray(variances <= settings.largest_variance_ratio * np.median(variances))
        if len(variances)
        else (np.zeros(0, bool))
    )


def by_prediction(navigation: Estimate, closures: Sequence[Closure], settings: factor.Settings) -> np.ndarray:
    """Return whether (k,) each closure agrees with navigation and all the others, Eq. 16 of docs/closures.md.

    The prediction is that of a graph without the closure, whose drift is drift_factor times what navigation says. The
    worst is left out, and all are judged again, until none is beyond the quantile gate_probability (Baarda's data
    snooping). Residual and variance of a closure that is left out follow from the inverse of the innovations' S.
    """
    passed = np.ones(len(closures), bool)
    J, r = linearised(closures, navigation.poses)
    if not len(r):
        return passed
    S = settings.drift_factor**2 * (J @ np.asarray((J @ navigation.covariance).T)) + np.eye(len(r))
    inverse, rows = np.linalg.inv(S), _rows(closures)
    while True:
        pull = inverse @ r
        excess = [
            _excess(pull[own], inverse[own, own], settings) if passed[k] and own.stop > own.start else 0.0
            for k, own in enumerate(rows)
        ]
        worst = int(np.argmax(excess))
        if excess[worst] <= 1:
            return passed
        passed[worst] = False
        inverse, r = _without(inverse, r, rows[worst])


def _rows(closures: Sequence[Closure]) -> list[slice]:
    ends = np.cumsum([closure.rank for closure in closures]).tolist()
    return [slice(end - closure.rank, end) for end, closure in zip(ends, closures, strict=True)]


def _excess(pull: np.ndarray, precision: np.ndarray, settings: factor.Settings) -> float:
    # chi2 of the closure against all others, by its limit: with the block P of S^-1 its innovation is P^-1 (S^-1 r)
    chi2 = float(pull @ np.linalg.solve(precision, pull))
    return chi2 / float(stats.chi2.ppf(settings.gate_probability, 2))


def _without(inverse: np.ndarray, r: np.ndarray, rows: slice) -> tuple[np.ndarray, np.ndarray]:
    # S^-1 of the other rows, with zeros in these
    block = inverse[:, rows]
    left = inverse - block @ np.linalg.solve(inverse[rows, rows], block.T)
    left[rows], left[:, rows] = 0.0, 0.0
    return left, np.where(np.isin(np.arange(len(r)), np.arange(rows.start, rows.stop)), 0.0, r)
