"""The map-to-map error as the paper's authors measure it, on a grid that is stretched to the map.

Their grid has a fixed number of cells, whatever the map's size, so that its cells are small on a small map and not
square on a long one, and with them changes which points are compared. `map_to_map` has cells of a fixed size.
"""

from collections.abc import Sequence

import numpy as np

from pointnetkl.slam.consistency import consistency_map, map_kernel, map_to_map
from pointnetkl.surveys import pose

CELLS = 500  # along each side of the map
DRAWS = 10  # of a point from each submap in a cell


class MapToMapAuvlib:
    """The authors' measure for one survey's submaps, ready for many estimates of their poses.

    Assumed of it, where the paper is silent: the grid has 500 x 500 cells over the bounding box of all points, at
    these very poses; a cell with two submaps or more counts; in each of 10 draws one random point of each submap in
    it is compared with every other's nearest point in the cell and the eight around it, and the largest of these
    distances kept; a cell's error is the mean of its 10 draws, the map's the root mean square over cells. Theirs has
    all soundings, ours the points of the registration clouds.
    """

    def __init__(self, clouds: Sequence[np.ndarray], seed: int) -> None:
        """Prepare clouds (n_i, 3) in submap frames; equal poses get equal draws from the seed."""
        self._clouds, self._seed = clouds, seed
        self._owner = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])

    def __call__(self, poses: np.ndarray) -> float:
        """Return the error in metres for poses T_map_submap (n, 4, 4); NaN where no two submaps share a cell."""
        points = np.concatenate([pose.transform(T, p) for T, p in zip(poses, self._clouds, strict=True)])
        starts, order = map_kernel.grouped(_cells(points), CELLS * CELLS)
        points, owner, cell = points[order], self._owner[order], np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        # runs of points of one submap in one cell; one more ends the last
        first = np.flatnonzero(np.diff(owner, prepend=-1) | np.diff(cell, prepend=-1))
        count = np.diff(first, append=len(points))
        uniform = np.random.default_rng(self._seed).random((len(first), DRAWS))
        drawn = first[:, None] + (uniform * count[:, None]).astype(np.int64)
        runs = np.searchsorted(first, starts)
        error = np.empty(CELLS * CELLS)
        arguments = (CELLS, runs, np.append(first, len(points)), owner[first], drawn, points, error)
        map_to_map.in_shares(lambda begin, end: map_kernel.sampled_pairs(begin, end, *arguments), CELLS)
        return consistency_map.rms(error[error >= 0.0])


def _cells(points: np.ndarray) -> np.ndarray:
    low, span = points[:, :2].min(axis=0), np.maximum(np.ptp(points[:, :2], axis=0), 1e-9)
    place = (((points[:, axis] - low[axis]) * (CELLS / span[axis])).astype(np.int64) for axis in (0, 1))
    column, row = (np.minimum(each, CELLS - 1) for each in place)
    return column * CELLS + row
