"""A few independent draws of the label's own estimator: Monte Carlo as a method, by its number of registrations."""

import zlib
from dataclasses import dataclass

import numpy as np

from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.surveys.submap import Submap


@dataclass(frozen=True)
class Sampled:
    """Monte Carlo with `runs` registrations of the submap, drawn apart from those of its label."""

    name: str
    runs: int
    seed: int
    label: monte_carlo.Settings
    registration: gicp.Settings

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M), the same whatever the order of submaps and the number of workers."""
        # the runs stand where labels have a stream (registration.streams)
        rng = np.random.default_rng([self.seed, zlib.crc32(submap.survey.encode()), submap.number, self.runs])
        return monte_carlo.covariance(monte_carlo.errors(submap, self.runs, rng, self.label, self.registration).errors)
