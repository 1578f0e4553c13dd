"""Fitting a few numbers to training labels: what is fitted to, what comes out, and how it is judged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl import gicp, settings
from pointnetkl.covariance import gaussian, labelled
from pointnetkl.errors import PointNetKLError
from pointnetkl.submap import Submap


class FittingError(PointNetKLError):
    """There is nothing to fit to, or a fit's numbers are not what its method needs."""


@dataclass(frozen=True)
class Settings:
    """Section `fit` of the parameters.

    Raises:
        ValueError: there is no start, or the floor or the seed is negative.
    """

    seed: int  # of the starting points of a search
    floor_m2: float  # added to label and estimate alike, so that no tiny label decides the mean KL
    starts: int  # searches, of which the best counts

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        settings.require_seed(self.seed)
        settings.require_positive(self, "starts")
        if not self.floor_m2 >= 0:
            raise ValueError(f"floor_m2 is {self.floor_m2:g}, must not be negative")


@dataclass(frozen=True)
class Training:
    """Submaps of the training surveys, and their labels."""

    submaps: Sequence[Submap]
    labels: np.ndarray  # (n, 2, 2) m^2, each in its submap's frame
    registration: gicp.Settings


@dataclass(frozen=True)
class Fit:
    """What one method learned."""

    numbers: dict[str, float]
    mean_kl: float  # nats over the training submaps, with the floor


def training(
    surveys: Sequence[Sequence[Submap]], labels: Sequence[pd.DataFrame], registration: gicp.Settings
) -> Training:
    """Return surveys' submaps with their labels (tables with q_xx_m2, q_xy_m2, q_yy_m2).

    Raises:
        FittingError: there is not one submap.
        LabelledError, CovarianceError: a submap has no label, or one that is not a covariance.
    """
    matrices = [_matrix(s, gold) for each, gold in _pairs(surveys, labels) for s in each]
    if not matrices:
        raise FittingError("there is no training submap to fit to; name one survey at least in study.train")
    return Training([s for each in surveys for s in each], np.stack(matrices), registration)


def mean_kl(labels: np.ndarray, q: np.ndarray, floor: float) -> float:
    """Return the mean KL(label || q) in nats of covariances (n, 2, 2), `floor` m^2 added to both."""
    return float(gaussian.kl_divergence(gaussian.with_floor(labels, floor), gaussian.with_floor(q, floor)).mean())


def _pairs(
    surveys: Sequence[Sequence[Submap]], labels: Sequence[pd.DataFrame]
) -> list[tuple[Sequence[Submap], labelled.Labelled]]:
    gold = [labelled.from_table("monte_carlo", rows) for rows in labels]
    return list(zip(surveys, gold, strict=True))


def _matrix(submap: Submap, gold: labelled.Labelled) -> np.ndarray:
    return gaussian.check(gold.covariance(submap), f"{submap.survey}, submap {submap.number}, label")
