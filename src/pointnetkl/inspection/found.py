"""What was found in a file: its facts, and what its plots are drawn from."""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from pointnetkl.inspection.cells import Cells
from pointnetkl.inspection.facts import Facts


@dataclass(frozen=True)
class Drawing:
    """What is drawn of a file, in metres of its CRS."""

    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))  # z up; only where they make no cells
    cells: Cells | None = None
    track: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    swaths: pd.DataFrame | None = None  # valid soundings of some pings, columns as survey.SOUNDINGS
    pings: pd.DataFrame | None = None  # survey.PINGS

    @property
    def places(self) -> np.ndarray:
        """Places (n, 2) that a map must reach."""
        corners = [] if self.cells is None else [np.reshape(self.cells.extent, (2, 2)).T]
        return np.concatenate([self.points[:, :2], self.track, *corners])


@dataclass(frozen=True)
class Found:
    """A file's facts, and its drawing where there is something to draw."""

    facts: Facts
    drawing: Drawing | None = None
