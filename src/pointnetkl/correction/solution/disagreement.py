"""How far the depths disagree that passes over the same ground give: the rms over cells, and by cell."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.slam.graph import footprint
from pointnetkl.surveys import pose

CELL_SPACINGS = 3.0  # edge of the cells: a pass has some nine points in each
_FEWEST = 3  # points of a pass in a cell, for a mean


@dataclass(frozen=True)
class Cells:
    """The cells that two or more passes share."""

    xy: np.ndarray  # (k, 2) their middles, metres in the map frame
    difference_m: np.ndarray  # (k,) from the shallowest pass's mean depth to the deepest's

    @property
    def rms_m(self) -> float:
        """Return the rms difference, metres; NaN without cells."""
        return float(np.sqrt(np.mean(self.difference_m**2))) if len(self.difference_m) else float("nan")


def measure(clouds: Sequence[np.ndarray], poses: np.ndarray, passes: np.ndarray, spacing_m: float) -> Cells:
    """Return the cells that passes share.

    Args:
        clouds: n submaps' points (n_i, 3), in their own frames.
        poses: T_map_submap (n, 4, 4).
        passes: (n,) the pass that each submap is of.
        spacing_m: of the points.
    """
    cell = CELL_SPACINGS * spacing_m
    means = [_means(clouds, poses, np.flatnonzero(passes == k), cell) for k in np.unique(passes)]
    table = pd.concat(means)
    grouped = table.groupby("key", sort=True)["z"].agg(["min", "max", "size"])
    shared = grouped[grouped["size"] > 1]
    column, row = footprint.places(shared.index.to_numpy())
    middles = cell * (np.column_stack([column, row]) + 0.5)
    return Cells(middles, (shared["max"] - shared["min"]).to_numpy())


def _means(clouds: Sequence[np.ndarray], poses: np.ndarray, submaps: np.ndarray, cell: float) -> pd.DataFrame:
    """Return the mean height of a pass in each of its cells with enough points."""
    points = np.concatenate([pose.transform(poses[k], clouds[k]) for k in submaps.tolist()])
    sums = pd.DataFrame({"key": footprint.keys(points, cell), "z": points[:, 2]}).groupby("key")["z"]
    table = sums.agg(["mean", "size"]).reset_index()
    return table[table["size"] >= _FEWEST].rename(columns={"mean": "z"})[["key", "z"]]
