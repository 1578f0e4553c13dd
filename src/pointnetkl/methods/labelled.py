"""Covariances that stand in a label table: Monte Carlo itself, the gold standard."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import table
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow.errors import PointNetKLError


class LabelledError(PointNetKLError):
    """A submap has no label."""


@dataclass(frozen=True)
class Labelled:
    """The label of the submap, of one survey."""

    name: str
    labels: Mapping[int, np.ndarray]  # by submap number: (M, M) m^2 (and m rad, rad^2)

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return the submap's label, (M, M).

        Raises:
            LabelledError: the submap has none.
        """
        if submap.number not in self.labels:
            raise LabelledError(
                f"{submap.survey}, submap {submap.number}: has no label, though {len(self.labels)} submaps have;"
                f" run dvc repro label@{submap.survey}"
            )
        return self.labels[submap.number]


def from_table(name: str, labels: pd.DataFrame) -> Labelled:
    """Return the labels of one survey's table (submap, and the columns of covariances)."""
    return Labelled(name, dict(zip(labels["submap"].astype(int), table.to_matrices(labels), strict=True)))
