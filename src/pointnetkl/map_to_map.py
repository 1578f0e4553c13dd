"""Consistency of a map where submaps overlap (after Roman and Singh 2006): how far apart they lie there.

In each cell of the map, for every ordered pair of submaps in it: the mean over a's points of the distance to b's
nearest point. A cell counts its worst pair, the map the root mean square over its cells. Neighbouring points of
one surface are never closer than their spacing allows, so a perfect map of independent soundings is not at zero.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl import footprint, pose
from pointnetkl.errors import PointNetKLError


class MapToMapError(PointNetKLError):
    """The measure is asked for with settings that have no meaning."""


class MapToMap:
    """The measure for one survey's submaps, ready for many estimates of their poses."""

    def __init__(self, clouds: Sequence[np.ndarray], cell: float, thinning: int) -> None:
        """Prepare clouds (n_i, 3) in submap frames; cells of `cell` metres; every `thinning`-th point asks.

        Only the points that ask are thinned. What they are compared with stays whole: thinning it would
        lengthen every distance.

        Raises:
            MapToMapError: the cell or the thinning is not positive.
        """
        if cell <= 0 or thinning < 1:
            raise MapToMapError(f"cell is {cell:g} m and thinning {thinning}, must be above 0 and at least 1")
        self._cell = cell
        self._asking = [cloud[::thinning] for cloud in clouds]
        # in the submaps' own frames, where they stay the same whatever the poses
        self._trees = [cKDTree(cloud) for cloud in clouds]

    def __call__(self, poses: np.ndarray) -> float:
        """Return the error in metres for poses T_map_submap (n, 4, 4); NaN where no two submaps share a cell."""
        placed = [pose.transform(T, points) for T, points in zip(poses, self._asking, strict=True)]
        points, owner = np.concatenate(placed), np.repeat(np.arange(len(placed)), [len(p) for p in placed])
        cells, cell = np.unique(footprint.keys(points, self._cell), return_inverse=True)
        by_cell = np.split(np.argsort(cell, kind="stable"), np.cumsum(np.bincount(cell))[:-1])
        worst = np.full(len(cells), -1.0)  # below zero: fewer than two submaps
        for b, tree in enumerate(self._trees):
            here = np.concatenate([by_cell[c] for c in np.unique(cell[owner == b])])
            asking = here[owner[here] != b]
            distance, _ = tree.query(pose.transform(np.linalg.inv(poses[b]), points[asking]))
            pair, place, count = np.unique(
                owner[asking] * len(cells) + cell[asking], return_inverse=True, return_counts=True
            )
            np.maximum.at(worst, pair % len(cells), np.bincount(place, distance, len(pair)) / count)
        shared = worst[worst >= 0.0]
        return float(np.sqrt(np.mean(shared**2))) if len(shared) else float("nan")
