"""One covariance for every submap: the mean of labels, which is the constant with the least mean KL to them."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import fitting
from pointnetkl.registration.covariance import table
from pointnetkl.surveys.submap import Submap


@dataclass(frozen=True)
class Constant:
    """The same covariance, whatever the submap."""

    name: str
    q: np.ndarray  # (M, M) m^2 (and m rad, rad^2)

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return the constant, (M, M)."""
        return self.q


def mean(name: str, labels: np.ndarray) -> Constant:
    """Return the mean of labels (n, M, M).

    Over the labels of the test survey itself it is the paper's "Constant Q", known only a posteriori.
    """
    return Constant(name, labels.mean(axis=0))


def names(dimensions: int) -> tuple[str, ...]:
    """Return the names of the numbers of a constant (M, M)."""
    return tuple(table.to_columns(np.zeros((dimensions, dimensions))))


def fit(training: fitting.Training, settings: fitting.Settings) -> fitting.Fit:
    """Return the mean of the training labels."""
    q = training.labels.mean(axis=0)
    numbers = {name: float(value) for name, value in table.to_columns(q).items()}
    return fitting.Fit(numbers, fitting.mean_kl(training.labels, q, settings.floor_m2))


def from_fit(name: str, fit: fitting.Fit, setup: SelfRegistration) -> Constant:
    """Return the constant of a fit's numbers."""
    return Constant(name, table.to_matrices(pd.DataFrame([fit.numbers]))[0])
