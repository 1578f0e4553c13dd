"""The map-to-map error as the paper's authors measure it, on a grid that is stretched to the map.

Their grid has a fixed number of cells. So the cells are small on a small map and not square on a long one, and the
points that are compared depend on them. `map_to_map` has cells of a fixed size.
"""

from collections.abc import Sequence

import numpy as np

from pointnetkl.slam.consistency import consistency_map, map_kernel, map_to_map
from pointnetkl.surveys import pose

CELLS = 500  # along each side of the map
DRAWS = 10  # of a point from each submap in a cell


class MapToMapAuvlib:
    """The authors' measure for one survey's submaps, ready for many estimates of their poses.

    The paper leaves details open; we assume the following. The grid has 500 x 500 cells over the bounding box of all
    points at the poses in question. Cells with two submaps or more count. Each of 10 draws takes one random point of
    each submap in a cell, measures its distance to every other submap's nearest point in the cell and the eight around
    it, and keeps the largest. A cell's error is the mean of its 10 draws, the map's error the root mean square over
    cells. Theirs uses all soundings, ours the points of the registration clouds.
    """

    def __init__(self, clouds: Sequence[np.ndarray], seed: int) -> None:
        """Prepare clouds (n_i, 3) in submap frames; equal poses have equal draws."""
        self._clouds, self._seed = clouds, seed
        self._owner = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])

    def __call__(self, poses: np.ndarray) -> float:
        """Return the error in metres for poses T_map_submap (n, 4, 4); NaN where no two submaps share a cell."""
        points = np.concatenate([pose.transform(T, p) for T, p in zip(poses, self._clouds, strict=True)])
        starts, order = map_kernel.grouped(_cells(points), CELLS * CELLS)
        points, owner, cell = points[order], self._owner[order], np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        # a run is the points of one submap in one cell
        first = np.flatnonzero(np.diff(owner, prepend=-1) | np.diff(cell, prepend=-1))
        count = np.diff(first, append=len(points))
        uniform = np.random.default_rng(self._seed).random((len(first), DRAWS))
        drawn = first[:, None] + (uniform * count[:, None]).astype(np.int64)
        runs = map_kernel.Runs(np.searchsorted(first, starts), np.append(first, len(points)), owner[first], points)
        error = np.empty(CELLS * CELLS)
        arguments = (CELLS, runs, drawn, error)
        map_to_map.in_shares(lambda begin, end: map_kernel.sampled_pairs(begin, end, *arguments), CELLS)
        return consistency_map.rms(error[error >= 0.0])


def _cells(points: np.ndarray) -> np.ndarray:
    low, span = points[:, :2].min(axis=0), np.maximum(np.ptp(points[:, :2], axis=0), 1e-9)
    indices = (((points[:, axis] - low[axis]) * (CELLS / span[axis])).astype(np.int64) for axis in (0, 1))
    column, row = (np.minimum(index, CELLS - 1) for index in indices)
    return column * CELLS + row
