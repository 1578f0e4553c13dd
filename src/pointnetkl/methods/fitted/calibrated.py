"""Closed forms combined with the prior, by two numbers that training labels give.

A closed form says how surely the matches hold the submap, once it is where they do. Of two numbers we learn how sure
it must be to get there: where the information that it has in a direction is w times the prior's, the variance is the
prior's / (1 + (w / ratio)^gamma). The prior's itself on flat ground, where w is small.

Only the part of the weights along the normals counts: GICP's weights hold in the plane as well, on any ground.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from pointnetkl.methods.closed_forms import censi, hessian
from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import fitting
from pointnetkl.registration import gicp
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import compute

Form = Callable[[gicp.Linearised, SelfRegistration], np.ndarray]  # a closed form, (M, M), of a solution

# of log ratio and gamma: far outside what any seabed gives, so that a search never overflows
_BOUNDS = ((-10.0, 20.0), (0.1, 8.0))
_STARTS = tuple((log_ratio, gamma) for log_ratio in (0.0, 3.0, 6.0, 9.0) for gamma in (1.0, 3.0))


@dataclass(frozen=True)
class Calibrated:
    """A closed form of the submap registered to a noisy copy of itself, combined with the prior."""

    name: str
    form: Form
    ratio: float
    gamma: float
    setup: SelfRegistration

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2)."""
        raw = _raw(self.form, self.setup, submap)
        return combine(raw[None], self.setup.prior(), np.log(self.ratio), self.gamma)[0]


@dataclass(frozen=True)
class Learner:
    """Learns the two numbers of a closed form."""

    form: Form

    def names(self, dimensions: int) -> tuple[str, ...]:
        """Return the names of the two numbers."""
        return ("ratio", "gamma")

    def fit(self, training: fitting.Training, settings: fitting.Settings) -> fitting.Fit:
        """Return the numbers with the least mean KL to the training labels."""
        setup = training.setup
        raw = np.stack(compute.in_threads(lambda s: _raw(self.form, setup, s), training.submaps, "closed form"))
        return fit_forms(raw, setup.prior(), training.labels, settings)

    def from_fit(self, name: str, fit: fitting.Fit, setup: SelfRegistration) -> Calibrated:
        """Return the method of a fit's numbers."""
        return Calibrated(name, self.form, fit.numbers["ratio"], fit.numbers["gamma"], setup)


HESSIAN = Learner(lambda solution, setup: hessian.covariance_at(solution))
CENSI = Learner(lambda solution, setup: censi.sandwich(solution, setup.label.noise_sigma_m))


def combine(raw: np.ndarray, prior: np.ndarray, log_ratio: float, gamma: float) -> np.ndarray:
    """Return closed forms (n, M, M) combined with the prior (M, M)."""
    root = np.linalg.cholesky(prior)
    inverse = np.linalg.inv(root)
    share, v = np.linalg.eigh(inverse @ raw @ inverse.T)  # of the prior's variance: 1 / w
    share_kept = special.expit(gamma * (log_ratio + np.log(np.maximum(share, 1e-30))))
    whitened = (v * share_kept[:, None, :]) @ np.swapaxes(v, 1, 2)
    return np.asarray(root @ whitened @ root.T)


def fit_forms(raw: np.ndarray, prior: np.ndarray, labels: np.ndarray, settings: fitting.Settings) -> fitting.Fit:
    """Return the two numbers with the least mean KL of labels to closed forms combined with the prior."""

    def mean_kl(p: np.ndarray) -> float:
        return fitting.mean_kl(labels, combine(raw, prior, p[0], p[1]), settings.floor_m2)

    best = fitting.search(mean_kl, np.array(_STARTS), _BOUNDS)
    log_ratio, gamma = best.x
    return fitting.Fit({"ratio": float(np.exp(log_ratio)), "gamma": float(gamma)}, float(best.fun))


def _raw(form: Form, setup: SelfRegistration, submap: Submap) -> np.ndarray:
    return form(setup.solution(submap).along_normals, setup)
