"""What a sample of registration errors says of the covariance taken from it: how sure it is, and how many basins."""

import numpy as np

_SINGULAR = 1e-12  # determinant of a correlation that rounding alone may give errors on a line
_DIRECTIONS = 90  # in which a variance's error is looked at: it is smooth between them
_SMALLEST_SIGMA_M = (
    0.05  # of a basin, which reaches three of these: registrations nearer are in it, however tight the rest
)


def standard_errors(errors: np.ndarray) -> np.ndarray:
    """Return the standard errors of the covariance's xx, xy and yy, m^2, by the errors' (L, 2) fourth moments."""
    rows, columns = np.triu_indices(errors.shape[1])
    return np.asarray((errors[:, rows] * errors[:, columns]).std(axis=0) / np.sqrt(len(errors)))


def relative_error(errors: np.ndarray) -> float:
    """Return the largest standard error of a variance u^T Q u over all directions u, as a share of that variance.

    By fourth moments of w = u^T e: sqrt((E w^4 / (E w^2)^2 - 1) / L) (Cramér 1946, 27.4), so sqrt(2 / L) for Gaussian
    errors. No linear change of coordinates changes it. Infinite where the errors (L, 2) lie on a line.
    """
    q = errors.T @ errors / len(errors)
    if np.linalg.det(q) <= _SINGULAR * np.prod(np.diag(q)):
        return float("inf")
    whitened = np.linalg.solve(np.linalg.cholesky(q), errors.T)
    x, y = whitened
    products = np.stack([x * x, x * y, y * y])
    angle = np.linspace(0, np.pi, _DIRECTIONS, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)
    weights = np.stack([c * c, 2 * c * s, s * s])  # of the products, in the square of c x + s y
    fourth = np.einsum("id,ij,jd->d", weights, products @ products.T / len(errors), weights)
    return float(np.sqrt(max(fourth.max() - 1, 0) / len(errors)))


def main_basin_share(errors: np.ndarray) -> float:
    """Return the share of errors (L, 2) within three robust sigmas of the main mode: 0.99 for a Gaussian.

    Along each principal axis the mode and sigma are those of the shortest interval that holds half of the errors
    (Rousseeuw's shortest half), so a second basin moves neither as long as it holds under half of them.
    """
    axes = np.linalg.eigh(errors.T @ errors)[1]
    along = errors @ axes
    ordered, half = np.sort(along, axis=0), len(along) // 2
    starts = np.argmin(ordered[half:] - ordered[: len(along) - half], axis=0)
    low, high = ordered[starts, (0, 1)], ordered[starts + half, (0, 1)]
    sigma = np.maximum((high - low) / (2 * 0.6745), _SMALLEST_SIGMA_M)  # 0.6745: a Gaussian's upper quartile
    return float(np.mean(np.linalg.norm((along - (low + high) / 2) / sigma, axis=1) <= 3))
