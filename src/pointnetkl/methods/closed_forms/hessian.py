"""The Hessian's covariance: the inverse information of a registration, scaled by how well its matches fit."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import catalogue
from pointnetkl.surveys.submap import Submap


@dataclass(frozen=True)
class Hessian:
    """s^2 H^-1 of the submap registered to a noisy copy of itself."""

    setup: SelfRegistration
    name: ClassVar[str] = catalogue.HESSIAN

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2)."""
        return covariance_at(self.setup.solution(submap))


def covariance_at(solution: gicp.Linearised) -> np.ndarray:
    """Return s^2 H^-1, (M, M), of a registration at its solution."""
    return np.asarray(residual_variance(solution) * np.linalg.inv(solution.information))


def residual_variance(solution: gicp.Linearised) -> float:
    """Return s^2 = sum r^T M r / (n - M): n matches give n numbers, because only the part along the normal measures."""
    r, dimensions = solution.residuals, solution.jacobian.shape[2]
    return float(np.einsum("ni,nij,nj->", r, solution.weights, r) / max(len(r) - dimensions, 1))
