"""Censi's covariance (2007): how the noise of the points reaches the solution, at fixed matches and weights."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import catalogue
from pointnetkl.surveys.submap import Submap


@dataclass(frozen=True)
class Censi:
    """H^-1 S H^-1 of the submap registered to a noisy copy of itself, whose noise is that of the labels."""

    setup: SelfRegistration
    name: ClassVar[str] = catalogue.CENSI

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2); only the copy is noisy."""
        return sandwich(self.setup.solution(submap), self.setup.label.noise_sigma_m)


def sandwich(solution: gicp.Linearised, source_sigma_m: float, target_sigma_m: float = 0.0) -> np.ndarray:
    """Return H^-1 S H^-1, (M, M), for noise N(0, sigma^2 I_3) on the points of the source and of the target.

    S is the sum of B Sigma B^T over the noisy points. A target's point may have several matches: it pulls by the sum
    of theirs.
    """
    pulls = np.linalg.inv(solution.information) @ solution.gains
    q = source_sigma_m**2 * _squares(pulls)
    if target_sigma_m > 0:
        q += target_sigma_m**2 * _squares(_by_target(pulls, solution.matches))
    return q


def _squares(pulls: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("nij,nkj->ik", pulls, pulls))


def _by_target(pulls: np.ndarray, matches: np.ndarray) -> np.ndarray:
    points, index = np.unique(matches, return_inverse=True)
    sums = np.zeros((len(points), *pulls.shape[1:]))
    np.add.at(sums, index, pulls)
    return sums
