"""One covariance for every submap: the mean of labels, which is the constant with the least mean KL to them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pointnetkl import gicp
from pointnetkl.covariance import fitting
from pointnetkl.submap import Submap

NUMBERS: tuple[str, ...] = ("q_xx_m2", "q_xy_m2", "q_yy_m2")


@dataclass(frozen=True)
class Constant:
    """The same covariance, whatever the submap."""

    name: str
    q: np.ndarray  # (2, 2) m^2

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return the constant, (2, 2) m^2."""
        return self.q


def mean(name: str, labels: np.ndarray) -> Constant:
    """Return the mean of labels (n, 2, 2).

    Over the labels of the test survey itself it is the paper's "Constant Q", known only a posteriori.
    """
    return Constant(name, labels.mean(axis=0))


def fit(training: fitting.Training, settings: fitting.Settings) -> fitting.Fit:
    """Return the mean of the training labels."""
    q = training.labels.mean(axis=0)
    numbers = dict(zip(NUMBERS, map(float, (q[0, 0], q[0, 1], q[1, 1])), strict=True))
    return fitting.Fit(numbers, fitting.mean_kl(training.labels, q, settings.floor_m2))


def from_numbers(name: str, numbers: Mapping[str, float], registration: gicp.Settings) -> Constant:
    """Return the constant of a fit's numbers."""
    xx, xy, yy = (numbers[key] for key in NUMBERS)
    return Constant(name, np.array([[xx, xy], [xy, yy]]))
