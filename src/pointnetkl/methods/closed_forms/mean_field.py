"""The mean field alone: what a registration does on average, tabulated from the submap's ground; nothing is learned."""

from dataclasses import dataclass

import numpy as np

from pointnetkl.models import mean_field
from pointnetkl.models.mean_field import MeanFieldError
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import catalogue
from pointnetkl.surveys.submap import Submap


@dataclass(frozen=True)
class MeanField:
    """The covariance of a few hundred copies that run down the tabulated mean forces of a submap."""

    label: monte_carlo.Settings  # of the copies: their prior and noise; they are of the submap's very points
    registration: gicp.Settings
    name: str = catalogue.MEAN_FIELD

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2), in the submap's frame.

        With yaw (M = 3) the copies run in x and y as without it, and yaw stands apart, as `yaw_variance` says.

        Raises:
            MeanFieldError: the submap has no ground to tabulate.
        """
        conditions = mean_field.conditions(self.label, self.registration)
        try:
            description = mean_field.describe(submap.points, conditions)
        except MeanFieldError as error:
            raise MeanFieldError(f"{submap.survey}, submap {submap.number}: {error}") from error
        if self.registration.dimensions == 2:
            return description.covariance
        q = np.zeros((3, 3))
        q[:2, :2] = description.covariance
        q[2, 2] = description.yaw_variance(conditions)
        return q
