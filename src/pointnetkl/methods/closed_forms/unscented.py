"""The unscented covariance (Brossard 2020): a few registrations from chosen starts, and Censi's for the noise."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pointnetkl.methods.closed_forms import censi
from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.registration import monte_carlo
from pointnetkl.registration.covariance import catalogue
from pointnetkl.surveys.submap import Submap

_BETA = 2.0  # best for a Gaussian (Julier 2002); alpha 1 and kappa 0 leave no other weight but 1 / 2M


@dataclass(frozen=True)
class Unscented:
    """2 M + 1 registrations of one noisy copy from the sigma points of the prior, plus the sandwich."""

    setup: SelfRegistration
    name: ClassVar[str] = catalogue.UNSCENTED

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2)."""
        pair, noise = self.setup.clouds(submap), self.setup.noise(submap)
        # one call a start, because each copy of a call has noise of its own
        starts = sigma_points(self.setup.prior())[:, None]
        settings = (noise, self.setup.label, self.setup.registration)
        errors = np.concatenate(
            [monte_carlo.register_perturbed(submap, pair, start, *settings).errors for start in starts]
        )
        return spread(errors) + censi.sandwich(self.setup.solution(submap, pair), self.setup.label.noise_sigma_m)


def sigma_points(prior: np.ndarray) -> np.ndarray:
    """Return the 2 M + 1 sigma points of N(0, prior), (2 M + 1, M), the centre first."""
    columns = np.sqrt(len(prior)) * np.linalg.cholesky(prior).T
    return np.concatenate([np.zeros((1, len(prior))), columns, -columns])


def spread(errors: np.ndarray) -> np.ndarray:
    """Return the covariance (M, M) of errors (2 M + 1, M) of the sigma points, in their order."""
    outer = errors[1:]
    centred = errors - outer.mean(axis=0)  # the centre has no weight in the mean
    weights = np.array([_BETA, *np.full(len(outer), 1 / len(outer))])
    return np.asarray((weights[:, None] * centred).T @ centred)
