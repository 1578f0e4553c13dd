"""CELLO (Vega-Brown 2013): the mean of training labels, each weighted by how much its submap looks like this one.

What a submap looks like are hand-made features that no rotation changes, and a label is averaged in the frame of its
structure tensor: its variances along the steepest direction, across it, and of yaw. Their correlations are left out,
because a submap and its mirror image have the same features and opposite correlations.

The kernel is exp(-|scale (features - features')|^2 / 2). The scales, one a feature, are those with the least mean KL
when each submap is judged without what is remembered of its part of the track, whose submaps overlap.
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from pointnetkl.methods.closed_forms import censi, hessian
from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import fitting, structure_tensor
from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import catalogue, gaussian
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import compute

_FEATURES = ("slope_weakest", "slope_steepest", "slope_tails", "roughness", "roughness_tails", "misfit")
_SMALLEST = 1e-8  # of a mean square, m^2 or none: a slope of 1e-4, a roughness of 0.1 mm; so flat ground has logarithms
_BOUNDS = (-7.0, 5.0)  # of the logarithm of a scale, of features with unit variance
_COMMON = np.linspace(-1.0, 4.0, 11)  # logarithms of the scale that all features share at first


@dataclass(frozen=True)
class Appearance:
    """What a submap looks like."""

    features: np.ndarray  # (f,), logarithms, see `features`
    axes: np.ndarray  # (M, M), columns: along the weakest slope, the steepest one, and yaw


@dataclass(frozen=True)
class Cello:
    """The kernel-weighted mean of what is remembered of training submaps."""

    name: str
    scales: np.ndarray  # (f,)
    features: np.ndarray  # (n, f) of the training submaps
    variances: np.ndarray  # (n, M) m^2 (and rad^2) of their labels, along their axes
    setup: SelfRegistration

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2)."""
        appearance = appearance_of(submap, self.setup)
        weights = _weights(_squares(appearance.features[None] * self.scales, self.features * self.scales))
        return np.asarray((appearance.axes * (weights @ self.variances)) @ appearance.axes.T)


def features(dimensions: int) -> tuple[str, ...]:
    """Return the names of the features.

    All are logarithms: of the structure tensor's eigenvalues (a point), the slopes' kurtosis, the mean square distance
    of neighbours from their plane and its kurtosis, s^2 of the Hessian's covariance, and the variances of Censi's,
    as shares of the prior's.
    """
    return (*_FEATURES, *(f"information_{rank}" for rank in range(dimensions)))


def appearance_of(submap: Submap, setup: SelfRegistration) -> Appearance:
    """Return what a submap looks like."""
    clouds = setup.clouds(submap)
    cloud, solution = clouds[1], setup.solution(submap, clouds)
    slopes = structure_tensor.slopes(cloud.normals.astype(np.float64))
    w, v = np.linalg.eigh(slopes.T @ slopes / len(slopes))
    axes = np.eye(setup.registration.dimensions)
    axes[:2, :2] = v
    rough = roughness(cloud)
    numbers = [*w, _kurtosis((slopes**2).sum(axis=1)), rough.mean(), _kurtosis(rough)]
    logarithms = np.log([*np.maximum(numbers, _SMALLEST), hessian.residual_variance(solution)])
    return Appearance(np.concatenate([logarithms, _information(solution, setup)]), axes)


def roughness(cloud: gicp.Cloud) -> np.ndarray:
    """Return the mean square distance, (n,) m^2, of each point's neighbours from their plane."""
    xx, xy, xz, yy, yz, zz = np.moveaxis(cloud.neighbourhoods[:, 3:], 1, 0).reshape(6, -1)[:, : len(cloud.points)]
    scatter = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3).astype(np.float64)
    n = cloud.normals.astype(np.float64)
    return np.maximum(np.einsum("ni,nij,nj->n", n, scatter, n), 0.0) / cloud.lists.shape[1]


def names(dimensions: int) -> tuple[str, ...]:
    """Return the names of the scales."""
    return tuple(f"scale_{name}" for name in features(dimensions))


def fit(training: fitting.Training, settings: fitting.Settings) -> fitting.Fit:
    """Return the scales with the least mean KL to the training labels, and what is remembered of the submaps."""
    appearances = compute.in_threads(lambda s: appearance_of(s, training.setup), training.submaps, catalogue.CELLO)
    axes = np.stack([appearance.axes for appearance in appearances])
    features = np.stack([appearance.features for appearance in appearances])
    floored = _along(gaussian.with_floor(training.labels, settings.floor_m2), axes)
    spread = np.maximum(features.std(axis=0), 1e-6)
    block = blocks([s.survey for s in training.submaps], settings.blocks)
    judge = _Judge(features / spread, floored, block, settings.judged)
    scales, score = judge.best()
    determinants = np.linalg.slogdet(gaussian.with_floor(training.labels, settings.floor_m2))[1]
    entropy = determinants[judge.judged].mean() + training.labels.shape[1]
    numbers = dict(zip(names(axes.shape[1]), map(float, scales / spread), strict=True))
    rows = np.concatenate([features, _along(training.labels, axes)], axis=1)
    return fitting.Fit(numbers, float(score - 0.5 * entropy), _rounded(rows))


def from_fit(name: str, fit: fitting.Fit, setup: SelfRegistration) -> Cello:
    """Return the method of a fit's scales and what it remembers.

    Raises:
        FittingError: it remembers nothing, or rows of another length.
    """
    scales = np.array([fit.numbers[key] for key in names(setup.registration.dimensions)])
    rows, length = np.array(fit.rows), len(scales) + setup.registration.dimensions
    if rows.ndim != 2 or rows.shape[1] != length:
        raise fitting.FittingError(f"{name}: remembers no rows of {length} numbers; run dvc repro fit")
    return Cello(name, scales, rows[:, : len(scales)], rows[:, len(scales) :], setup)


def blocks(surveys: list[str], count: int) -> np.ndarray:
    """Return the block, (n,), of each submap: `count` of consecutive ones in each survey."""
    names, survey = np.unique(surveys, return_inverse=True)
    block = np.empty(len(surveys), np.int64)
    for number in range(len(names)):
        members = np.flatnonzero(survey == number)
        block[members] = number * count + np.arange(len(members)) * count // len(members)
    return block


class _Judge:
    """Mean KL, but for a constant, of submaps' labels to the kernel-weighted mean of those of other blocks."""

    def __init__(self, features: np.ndarray, variances: np.ndarray, block: np.ndarray, most: int) -> None:
        self.judged = np.unique(np.linspace(0, len(features) - 1, min(most, len(features))).astype(int))
        self._features, self._variances = features, variances
        self._own = block[self.judged, None] == block
        self._own &= ~self._own.all(axis=1, keepdims=True)  # where there is but one block, by itself

    def best(self) -> tuple[np.ndarray, float]:
        """Return the best scales, (f,), and what they reach: first one scale for all features, then one for each."""
        count = self._features.shape[1]
        common = min(_COMMON, key=lambda scale: self(np.full(count, scale))[0])
        result = optimize.minimize(
            self, np.full(count, common), jac=True, method="L-BFGS-B", bounds=[_BOUNDS] * count, options={"maxiter": 60}
        )
        return np.exp(result.x), float(result.fun)

    def __call__(self, log_scales: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the mean of (label / q + ln q) / 2 and its gradient."""
        squared = np.exp(2 * log_scales)
        x, y, label = self._features[self.judged], self._features, self._variances[self.judged]
        squares = _squares(x * np.exp(log_scales), y * np.exp(log_scales))
        squares[self._own] = np.inf
        weights = _weights(squares)
        q = weights @ self._variances
        by_q = 0.5 * (1 / q - label / q**2) / len(q)
        # of half a squared distance: minus the weight, times how far its variances are from the mean
        by_square = -weights * (by_q @ self._variances.T - (by_q * q).sum(axis=1, keepdims=True))
        gradient = by_square.sum(axis=1) @ x**2 + by_square.sum(axis=0) @ y**2 - 2 * (x * (by_square @ y)).sum(axis=0)
        return float(0.5 * (label / q + np.log(q)).sum(axis=1).mean()), gradient * squared


def _information(solution: gicp.Linearised, setup: SelfRegistration) -> np.ndarray:
    prior = np.sqrt(np.diag(setup.prior()))
    q = censi.sandwich(solution.along_normals, setup.label.noise_sigma_m) / np.outer(prior, prior)
    return np.log(np.maximum(np.linalg.eigvalsh(q), 1e-30))


def _kurtosis(squares: np.ndarray) -> float:
    # of numbers by their squares; 1 where all are zero
    return float((np.mean(squares**2) + _SMALLEST**2) / (np.mean(squares) ** 2 + _SMALLEST**2))


def _along(q: np.ndarray, axes: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("nji,njk,nki->ni", axes, q, axes))


def _squares(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    # half squared distances, (k, n)
    halves = 0.5 * (x**2).sum(axis=1)[:, None] + 0.5 * (y**2).sum(axis=1) - x @ y.T
    return np.maximum(halves, 0.0)


def _weights(squares: np.ndarray) -> np.ndarray:
    # the nearest has one before they are made to sum to one: far from all, it decides alone
    weights = np.exp(squares.min(axis=1, keepdims=True) - squares)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _rounded(rows: np.ndarray) -> tuple[tuple[float, ...], ...]:
    # six digits are what the file of fits holds
    return tuple(tuple(float(f"{value:.6g}") for value in row) for row in rows)
