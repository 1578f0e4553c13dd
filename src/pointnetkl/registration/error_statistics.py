"""Statistics of registration errors: the standard error of their covariance, and the share of their main basin."""

import numpy as np

_SINGULAR = 1e-12  # determinant of a correlation that rounding alone may give errors on a line
_DIRECTIONS = {2: 90, 3: 1000}  # number of directions u, by M; the error of u^T Q u is smooth between them
# Of a basin, which reaches three sigmas: errors nearer than that are in it, even if half of them are all but equal.
_SMALLEST_SIGMA_M = 0.05


def standard_errors(errors: np.ndarray) -> np.ndarray:
    """Return the standard errors (M, M) of the covariance's entries, by the errors' (L, M) fourth moments."""
    rows, columns = np.triu_indices(errors.shape[1])
    standard_error = np.empty(2 * errors.shape[1:])
    standard_error[rows, columns] = (errors[:, rows] * errors[:, columns]).std(axis=0) / np.sqrt(len(errors))
    standard_error[columns, rows] = standard_error[rows, columns]
    return standard_error


def relative_error(errors: np.ndarray) -> float:
    """Return the largest standard error of a variance u^T Q u over all directions u, as a share of that variance.

    It follows from the fourth moments of w = u^T e: sqrt((E w^4 / (E w^2)^2 - 1) / L) (Cramér 1946, 27.4), which is
    sqrt(2 / L) for Gaussian errors. A linear change of coordinates does not change it. It is infinite where the errors
    (L, M) lie on a line or plane.
    """
    q = errors.T @ errors / len(errors)
    if np.linalg.det(q) <= _SINGULAR * np.prod(np.diag(q)):
        return float("inf")
    whitened = np.linalg.solve(np.linalg.cholesky(q), errors.T)
    rows, columns = np.triu_indices(len(whitened))
    products, u = whitened[rows] * whitened[columns], _directions(len(whitened))
    weights = u[rows] * u[columns] * np.where(rows == columns, 1, 2)[:, None]  # of the products, in (u^T e)^2
    fourth = np.einsum("id,ij,jd->d", weights, products @ products.T / len(errors), weights)
    return float(np.sqrt(max(fourth.max() - 1, 0) / len(errors)))


def main_basin_share(errors: np.ndarray) -> float:
    """Return the share of errors (L, M) with x, y within three robust sigmas of the main mode: 0.99 for a Gaussian.

    Along each principal axis mode and sigma are those of the shortest interval that holds half of the errors
    (Rousseeuw's shortest half). A second basin with under half of the errors moves neither.
    """
    errors = errors[:, :2]  # yaw starts near the truth and has no second basin of its own
    axes = np.linalg.eigh(errors.T @ errors)[1]
    projected = errors @ axes
    ordered, half = np.sort(projected, axis=0), len(projected) // 2
    starts = np.argmin(ordered[half:] - ordered[: len(projected) - half], axis=0)
    low, high = ordered[starts, (0, 1)], ordered[starts + half, (0, 1)]
    sigma = np.maximum((high - low) / (2 * 0.6745), _SMALLEST_SIGMA_M)  # 0.6745: a Gaussian's upper quartile
    return float(np.mean(np.linalg.norm((projected - (low + high) / 2) / sigma, axis=1) <= 3))


def _directions(dimensions: int) -> np.ndarray:
    """Return unit vectors (M, d) spread evenly over half a circle or, by Fibonacci's spiral, over half a sphere."""
    count = _DIRECTIONS[dimensions]
    if dimensions == 2:
        angle = np.linspace(0, np.pi, count, endpoint=False)
        return np.stack([np.cos(angle), np.sin(angle)])
    z, angle = (np.arange(count) + 0.5) / count, np.arange(count) * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
