"""The structure tensor's covariance: what the slopes of the seabed say about a registration, by four numbers.

T is the sum over points of g g^T, g = (dz/dx, dz/dy). Q has T's eigenvectors; along one with eigenvalue w the
variance is 1 / (c w^gamma + 1 / b) + f: on flat ground, w = 0, the spread b + f that the search starts with, and
on rugged ground the registration's own floor f. With yaw (M = 3) g has dz/dyaw too, a turn about the submap's mean, in
units of yaw in which its prior is that of x and y.
"""

from dataclasses import dataclass

import numpy as np

from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import fitting
from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.gicp import linearised
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import compute

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
    setup: SelfRegistration

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2)."""
        return self.from_tensors(_tensor_of(submap, self.setup)[None])[0]

    def from_tensors(self, tensors: np.ndarray) -> np.ndarray:
        """Return Q (n, M, M) of tensors (n, M, M)."""
        numbers = (self.c, self.gamma, self.b_m2, self.f_m2)
        return _covariances(*_axes(tensors, _units(self.setup.prior())), numbers)


def slope_tensor(normals: np.ndarray) -> np.ndarray:
    """Return T, (2, 2), the sum of g g^T over upward unit normals (n, 3)."""
    g = slopes(normals)
    return np.asarray(g.T @ g)


def slopes(normals: np.ndarray) -> np.ndarray:
    """Return (dz/dx, dz/dy), (n, 2), of upward unit normals (n, 3)."""
    horizontal = np.hypot(normals[:, 0], normals[:, 1])
    return np.asarray(-normals[:, :2] / np.maximum(np.maximum(normals[:, 2], horizontal / STEEPEST), 1e-12)[:, None])


def names(dimensions: int) -> tuple[str, ...]:
    """Return the names of the four numbers."""
    return NUMBERS


def fit(training: fitting.Training, settings: fitting.Settings) -> fitting.Fit:
    """Return the four numbers with the least mean KL to the training labels."""
    tensors = compute.in_threads(lambda s: _tensor_of(s, training.setup), training.submaps, catalogue.STRUCTURE_TENSOR)
    return fit_tensors(np.stack(tensors), training.setup.prior(), training.labels, settings)


def fit_tensors(tensors: np.ndarray, prior: np.ndarray, labels: np.ndarray, settings: fitting.Settings) -> fitting.Fit:
    """Return the four numbers with the least mean KL of labels (n, M, M) to what tensors (n, M, M) give."""
    w, v = _axes(tensors, _units(prior))

    def mean_kl(p: np.ndarray) -> float:
        return fitting.mean_kl(labels, _covariances(w, v, _numbers(p)), settings.floor_m2)

    best = fitting.search(mean_kl, _starts(w, labels[:, :2, :2], settings), _BOUNDS)
    return fitting.Fit(dict(zip(NUMBERS, _numbers(best.x), strict=True)), float(best.fun))


def from_fit(name: str, fit: fitting.Fit, setup: SelfRegistration) -> StructureTensor:
    """Return the method of a fit's numbers."""
    c, gamma, b, f = (fit.numbers[key] for key in NUMBERS)
    return StructureTensor(name, c, gamma, b, f, setup)


def _tensor_of(submap: Submap, setup: SelfRegistration) -> np.ndarray:
    # with yaw, T of a turn as well: the slope in the direction in which the turn moves a point
    cloud = gicp.prepare(submap.points, setup.registration)
    motions = linearised.jacobian(cloud.points - cloud.centre, setup.registration.dimensions)[:, :2]
    g = np.einsum("ni,nij->nj", slopes(cloud.normals.astype(np.float64)), motions)
    return np.asarray(g.T @ g)


def _units(prior: np.ndarray) -> np.ndarray:
    # 1, 1 and a yaw in rad that is to its prior what a metre is to that of x and y
    sigmas = np.sqrt(np.diag(prior))
    return np.asarray(sigmas / sigmas[0])


def _axes(tensors: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    w, v = np.linalg.eigh(tensors * np.outer(units, units))
    return w, units[:, None] * v


def _covariances(w: np.ndarray, v: np.ndarray, numbers: tuple[float, float, float, float]) -> np.ndarray:
    return np.asarray((v * _variances(w, *numbers)[:, None, :]) @ np.swapaxes(v, 1, 2))


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
    return np.stack([log_c, gamma, log_b, log_f], axis=1)
