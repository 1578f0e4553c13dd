"""Naive GICP: what the matches of a submap with itself weigh on average, the paper's "naive" baseline, in two readings.

Both know the shape of the ground but no scale of the error: about 2 I m^2 on flat seabed, by construction.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.gicp import linearised
from pointnetkl.surveys.submap import Submap


@dataclass(frozen=True)
class NaiveGicp:
    """([mean A^T (C_q + R C_p R^T)^-1 A])^-1: the inverse of the average information, as the paper has it."""

    registration: gicp.Settings
    name: ClassVar[str] = catalogue.NAIVE_GICP

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2)."""
        A, n = _matches(submap, self.registration)
        weights = linearised.weigh(n, n, self.registration.plane_epsilon)
        return np.asarray(np.linalg.inv(np.einsum("nia,nij,njb->ab", A, weights, A) / len(n)))


@dataclass(frozen=True)
class NaiveMeanCovariance:
    """[mean C_q + R C_p R^T]_xy: the average of the covariances, as the authors' code has it."""

    registration: gicp.Settings
    name: ClassVar[str] = catalogue.NAIVE_MEANCOV

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2); for M = 3 every match measures x, y with the average."""
        A, n = _matches(submap, self.registration)
        A, n = A[:, :2], n[:, :2]
        mean = 2 * (np.eye(2) - (1 - self.registration.plane_epsilon) * (n.T @ n) / len(n))
        return np.asarray(np.linalg.inv(np.einsum("nia,ij,njb->ab", A, np.linalg.inv(mean), A) / len(n)))


def _matches(submap: Submap, registration: gicp.Settings) -> tuple[np.ndarray, np.ndarray]:
    # every point matches itself: the Jacobians (n, 3, M) and the normals (n, 3)
    cloud = gicp.prepare(submap.points, registration)
    return linearised.jacobian(cloud.points - cloud.centre, registration.dimensions), cloud.normals.astype(np.float64)
