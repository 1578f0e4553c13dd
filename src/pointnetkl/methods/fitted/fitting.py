"""Fitting a few numbers to training labels: the training data, the result, and its mean KL divergence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import optimize

from pointnetkl.methods import labelled
from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.registration.covariance import catalogue, gaussian
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError


class FittingError(PointNetKLError):
    """There are no training submaps, or a fit lacks numbers that its method needs."""


@dataclass(frozen=True)
class Settings:
    """Section `fit` of the parameters.

    Raises:
        ValueError: there is no start, no two blocks, nothing to judge on, or the floor or the seed is negative.
    """

    seed: int  # of the starting points of a search, and of the noisy copies that closed forms look at
    floor_m2: float  # added to label and estimate alike, so that no tiny label decides the mean KL
    starts: int  # searches, of which the best counts
    blocks: int = 5  # of consecutive submaps in each survey: what is remembered of a block does not judge it
    judged: int = 1000  # submaps at most that what is remembered is judged on, evenly spread

    def __post_init__(self) -> None:
        """Refuse values out of their range."""
        parameters.require_seed(self.seed)
        parameters.require_positive(self, "starts", "judged")
        if self.blocks < 2:
            raise ValueError(f"blocks is {self.blocks}, must be at least 2: one block leaves none to judge it by")
        if not self.floor_m2 >= 0:
            raise ValueError(f"floor_m2 is {self.floor_m2:g}, must not be negative")


@dataclass(frozen=True)
class Training:
    """Submaps of the training surveys, and their labels."""

    submaps: Sequence[Submap]  # survey by survey, along the track
    labels: np.ndarray  # (n, M, M) m^2 (and m rad, rad^2), each in its submap's frame
    setup: SelfRegistration


@dataclass(frozen=True)
class Fit:
    """The numbers that one method learned."""

    numbers: dict[str, float]
    mean_kl: float  # nats over the training submaps, with the floor; of what is remembered: each judged by the others
    rows: tuple[tuple[float, ...], ...] = ()  # what is remembered, a row for each training submap


def training(surveys: Sequence[Sequence[Submap]], labels: Sequence[pd.DataFrame], setup: SelfRegistration) -> Training:
    """Return surveys' submaps with their labels (tables with the columns of covariances).

    Raises:
        FittingError: there is not one submap.
        LabelledError, CovarianceError: a submap has no label, or one that is not a covariance.
    """
    matrices = [_matrix(s, gold) for submaps, gold in _pairs(surveys, labels) for s in submaps]
    if not matrices:
        raise FittingError("there is no training submap to fit to; name one survey at least in study.train")
    return Training([s for submaps in surveys for s in submaps], np.stack(matrices), setup)


def mean_kl(labels: np.ndarray, q: np.ndarray, floor: float) -> float:
    """Return the mean KL(label || q) in nats of covariances (n, M, M), `floor` m^2 added to both."""
    return float(gaussian.kl_divergence(gaussian.with_floor(labels, floor), gaussian.with_floor(q, floor)).mean())


def search(
    objective: Callable[[np.ndarray], float], starts: np.ndarray, bounds: Sequence[tuple[float, float]]
) -> optimize.OptimizeResult:
    """Return the best of the searches for the least objective from starts (k, p), within bounds (p, 2)."""
    lower, upper = np.transpose(bounds)
    searches = [
        optimize.minimize(objective, start, method="L-BFGS-B", bounds=bounds) for start in np.clip(starts, lower, upper)
    ]
    return min(searches, key=lambda search: float(search.fun))


def _pairs(
    surveys: Sequence[Sequence[Submap]], labels: Sequence[pd.DataFrame]
) -> list[tuple[Sequence[Submap], labelled.Labelled]]:
    gold = [labelled.from_table(catalogue.MONTE_CARLO, rows) for rows in labels]
    return list(zip(surveys, gold, strict=True))


def _matrix(submap: Submap, gold: labelled.Labelled) -> np.ndarray:
    return gaussian.check(gold.covariance(submap), f"{submap.survey}, submap {submap.number}, label")
