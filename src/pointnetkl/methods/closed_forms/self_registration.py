"""A submap registered to a noisy copy of itself once, as its label is thousands of times: where closed forms look."""

import zlib
from dataclasses import dataclass

import numpy as np

from pointnetkl.registration import gicp, monte_carlo, streams
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow.errors import PointNetKLError


class SelfRegistrationError(PointNetKLError):
    """There is no noisy copy to look at."""


@dataclass(frozen=True)
class SelfRegistration:
    """How a submap is copied and registered: as for its label, but with noise of its own."""

    seed: int
    label: monte_carlo.Settings
    registration: gicp.Settings

    def clouds(self, submap: Submap) -> tuple[gicp.Cloud, gicp.Cloud]:
        """Return source and target; with label.copy `same` they are one cloud."""
        return monte_carlo.clouds(submap, self.label, self.registration)

    def noise(self, submap: Submap) -> gicp.Noise:
        """Return the noise of the one copy: of the submap and the seed alone.

        Raises:
            SelfRegistrationError: the copy would have none, and closed forms would say that nothing can go wrong.
        """
        if not self.label.noise_sigma_m > 0:
            raise SelfRegistrationError(
                f"{submap.survey}, submap {submap.number}: closed forms need a noisy copy, and label.noise_sigma_m is"
                f" {self.label.noise_sigma_m:g}; set it above zero, to the sonar's noise"
            )
        rng = np.random.default_rng(
            [self.seed, zlib.crc32(submap.survey.encode()), submap.number, *streams.SELF_REGISTRATION]
        )
        return gicp.Noise(self.label.noise_sigma_m, int(rng.integers(1 << 63)))

    def prior(self) -> np.ndarray:
        """Return the covariance, (M, M), of what a label's copies are moved by: what is known before registering."""
        return np.diag(monte_carlo.prior_sigmas(self.label, self.registration.dimensions) ** 2)

    def solution(self, submap: Submap, clouds: tuple[gicp.Cloud, gicp.Cloud] | None = None) -> gicp.Linearised:
        """Return the registration of the copy that is not moved, at its solution, with the yaw about the submap's mean.

        That is where labels have it. The submap's `clouds` may be given, to prepare them once.
        """
        source, target = clouds or self.clouds(submap)
        solution = gicp.solve(source, target, self.noise(submap), self.registration)
        return solution.with_centre(submap.points.mean(axis=0) - target.centre)
