"""The interface of methods that estimate Q."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import table
from pointnetkl.surveys.submap import Submap, SubmapError
from pointnetkl.workflow import compute


class Method(Protocol):
    """An estimator of the covariance of a submap's registration."""

    @property
    def name(self) -> str:
        """The method's name in every table."""

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 (and m rad, rad^2), in the submap's frame; every preprocessing step included."""


def tabulate(methods: Sequence[Method], submaps: Sequence[Submap]) -> pd.DataFrame:
    """Return the covariance table of every method for every submap of one survey, by method and submap.

    Raises:
        SubmapError: there are no submaps.
        CovarianceError: a method's answer is not a covariance.
    """
    if not submaps:
        raise SubmapError("there are no submaps to get covariances of; did segment keep any of this survey?")
    tables = []
    for method in methods:
        q = np.stack(compute.in_threads(method.covariance, submaps, method.name))
        tables.append(table.from_matrices(submaps[0].survey, method.name, [s.number for s in submaps], q))
    return pd.concat(tables, ignore_index=True)
