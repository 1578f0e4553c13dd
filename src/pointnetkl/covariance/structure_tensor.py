"""The structure tensor's covariance: what the slopes of the seabed say about a registration, by four numbers.

T is the sum over points of g g^T, g = (dz/dx, dz/dy). Q has T's eigenvectors; along one with eigenvalue w the
variance is 1 / (c w^gamma + 1 / b) + f: on flat ground, w = 0, the spread b + f that the search starts with, and
on rugged ground the registration's own floor f.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from pointnetkl import compute, gicp
from pointnetkl.covariance import fitting, gaussian
from pointnetkl.submap import Submap

NUMBERS: tuple[str, ...] = ("c", "gamma", "b_m2", "f_m2")
STEEPEST = 20.0  # 87 degrees: a wall's slope is infinite, and one such point must not decide the sum
# of log c, gamma, log b, log f: far outside what any seabed gives, so that a search never overflows
_BOUNDS = ((-60.0, 60.0), (0.05, 5.0), (-15.0, 10.0), (-25.0, 5.0))


@dataclass(frozen=True)
class StructureTensor:
    """Q from the submap's slopes and four fitted numbers."""

    name: str
    c: float
    gamma: float
    b_m2: float
    f_m2: float
    registration: gicp.Settings

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (2, 2) m^2."""
        return self.from_tensors(_tensor_of(submap, self.registration)[None])[0]

    def from_tensors(self, tensors: np.ndarray) -> np.ndarray:
        """Return Q (n, 2, 2) in m^2 of slope tensors (n, 2, 2)."""
        w, v = np.linalg.eigh(tensors)
        return (v * _variances(w, self.c, self.gamma, self.b_m2, self.f_m2)[:, None, :]) @ np.swapaxes(v, 1, 2)


def slope_tensor(normals: np.ndarray) -> np.ndarray:
    """Return T, (2, 2), the sum of g g^T over upward unit normals (n, 3)."""
    horizontal = np.hypot(normals[:, 0], normals[:, 1])
    g = -normals[:, :2] / np.maximum(np.maximum(normals[:, 2], horizontal / STEEPEST), 1e-12)[:, None]
    return g.T @ g


def fit(training: fitting.Training, settings: fitting.Settings) -> fitting.Fit:
    """Return the four numbers with the least mean KL to the training labels."""
    tensors = compute.in_threads(lambda s: _tensor_of(s, training.registration), training.submaps, "structure_tensor")
    return fit_tensors(np.stack(tensors), training.labels, settings)


def fit_tensors(tensors: np.ndarray, labels: np.ndarray, settings: fitting.Settings) -> fitting.Fit:
    """Return the four numbers with the least mean KL of labels (n, 2, 2) in m^2 to what tensors (n, 2, 2) give."""
    w, v = np.linalg.eigh(tensors)
    floored = gaussian.with_floor(labels, settings.floor_m2)
    # in T's eigenvectors Q is diagonal, and of the label only its diagonal counts
    along = np.einsum("nji,njk,nki->ni", v, floored, v)
    constant = -2 - np.linalg.slogdet(floored)[1].mean()

    def mean_kl(p: np.ndarray) -> float:
        q = _variances(w, *_numbers(p)) + settings.floor_m2
        return float(0.5 * ((along / q + np.log(q)).sum(axis=1).mean() + constant))

    starts = _starts(w, labels, settings)
    searches = [optimize.minimize(mean_kl, start, method="L-BFGS-B", bounds=_BOUNDS) for start in starts]
    best = min(searches, key=lambda search: float(search.fun))
    return fitting.Fit(dict(zip(NUMBERS, _numbers(best.x), strict=True)), float(best.fun))


def from_numbers(name: str, numbers: Mapping[str, float], registration: gicp.Settings) -> StructureTensor:
    """Return the method of a fit's numbers."""
    c, gamma, b, f = (numbers[key] for key in NUMBERS)
    return StructureTensor(name, c, gamma, b, f, registration)


def _tensor_of(submap: Submap, registration: gicp.Settings) -> np.ndarray:
    return slope_tensor(gicp.prepare(submap.points, registration).normals.astype(np.float64))


def _variances(w: np.ndarray, c: float, gamma: float, b: float, f: float) -> np.ndarray:
    return np.asarray(1 / (c * np.maximum(w, 0.0) ** gamma + 1 / b) + f)


def _numbers(p: np.ndarray) -> tuple[float, float, float, float]:
    return float(np.exp(p[0])), float(p[1]), float(np.exp(p[2])), float(np.exp(p[3]))


def _starts(w: np.ndarray, labels: np.ndarray, settings: fitting.Settings) -> np.ndarray:
    """Return starts (k, 4) about the labels' own scale: half way to the prior at the median eigenvalue."""
    rng = np.random.default_rng(settings.seed)
    variances = np.linalg.eigvalsh(labels)
    middle = np.log(max(float(np.median(w)), 1e-6))
    gamma = rng.uniform(0.5, 2.0, settings.starts)
    log_b = np.log(variances.max()) + rng.normal(0, 0.5, settings.starts)
    log_f = np.log(max(float(variances.min()), 1e-5)) + rng.normal(0, 1.0, settings.starts)
    log_c = -log_b - gamma * middle + rng.normal(0, 2.0, settings.starts)
    lower, upper = np.transpose(_BOUNDS)
    return np.clip(np.stack([log_c, gamma, log_b, log_f], axis=1), lower, upper)
