"""Naive GICP: the inverse of the average information of its matches (the paper's "naive" baseline)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pointnetkl import gicp
from pointnetkl.submap import Submap


@dataclass(frozen=True)
class NaiveGicp:
    """([mean (C_q + R C_p R^T)^-1]_xy)^-1 of the submap registered to itself.

    It knows the shape of the ground but no scale of the error: about 2 I m^2 on flat seabed, by construction.
    """

    registration: gicp.Settings
    name: ClassVar[str] = "naive_gicp"

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (2, 2) m^2."""
        n = gicp.prepare(submap.points, self.registration).normals[:, :2].astype(np.float64)
        # C = I - (1 - eps) n n^T, so (2 C)^-1 = (I + (1 / eps - 1) n n^T) / 2; only its xy block counts
        information = 0.5 * (np.eye(2) + (1 / self.registration.plane_epsilon - 1) * (n.T @ n) / len(n))
        return np.linalg.inv(information)
