"""The covariance of an end by the region of small misfit about it, as mbnavadjust of MB-System takes it.

mbnavadjust (Caress and Chayes, MB-System) ties two swaths by the offset at which their depths agree best. What it says
of that offset's errors is the extent of the region whose misfit is below three times the least, on a grid of offsets.
Here the misfit is the mean squared difference of heights, the grid has 61 x 61 offsets within three sigmas of the start
about an end, and Q is the region's second moment about that end. On ground without relief the region is the whole grid.
mbnavadjust knows no yaw, and neither does this.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

_HALF = 30  # offsets on each side of the end: 61 along each axis
_REACH_SIGMAS = 3.0  # of the start, to the edge of the grid
_TIMES_LEAST = 3.0
_MOST_POINTS = 500  # of the source, evenly taken: the least misfit is within 6 % of that of all
_LEAST_SHARE = 0.5  # of these points that must lie over the target for an offset to count
_HEIGHTS_PER_SPACING = 2.0  # of the target that are looked up; those between are linear


@dataclass(frozen=True)
class Relief:
    """The heights of a target on a raster whose cells are the steps of offsets."""

    heights: np.ndarray  # (columns, rows) float32 metres, NaN where there is no point within reach
    corner: np.ndarray  # (2,) metres, where heights[0, 0] is
    step_m: float


def relief(
    points: np.ndarray, normals: np.ndarray, box: tuple[np.ndarray, np.ndarray], spacing_m: float, sigma_m: float
) -> Relief:
    """Return the relief of a target, points (n, 3) in metres with unit normals (n, 3), for offsets of a start.

    A height is that of the plane of the nearest point, within two spacings. `box` has the lowest and the highest x and
    y (2,) of what will be laid on it at any offset; `sigma_m` is the start's standard deviation in x and in y.
    """
    step = max(_REACH_SIGMAS * sigma_m, spacing_m) / _HALF
    between = max(1, round(spacing_m / _HEIGHTS_PER_SPACING / step))
    low, high = np.maximum(box[0], points[:, :2].min(axis=0)), np.minimum(box[1], points[:, :2].max(axis=0))
    columns, rows = np.maximum(np.ceil((high - low) / (between * step)), 1).astype(int) + 1
    corners = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1) * (between * step) + low
    distance, nearest = cKDTree(points[:, :2]).query(corners, distance_upper_bound=2 * spacing_m)
    known = np.isfinite(distance)
    slopes = -normals[:, :2] / np.maximum(normals[:, 2:], 1e-3)
    coarse, j = np.full(known.shape, np.nan, np.float32), nearest[known]
    coarse[known] = points[j, 2] + (slopes[j] * (corners[known] - points[j, :2])).sum(axis=1)
    return Relief(_finer(_finer(coarse, between).T, between).T, low, step)


def covariance(points: np.ndarray, target: Relief) -> np.ndarray:
    """Return Q (2, 2) in m^2 of an end, of source points (n, 3) where it has laid them, in the target's axes."""
    misfit = misfits(points, target)
    offsets = np.stack(np.meshgrid(*2 * [np.arange(-_HALF, _HALF + 1)], indexing="ij"), -1) * target.step_m
    if np.isfinite(misfit).any():
        offsets = offsets[misfit <= _TIMES_LEAST * np.nanmin(misfit)]
    offsets = offsets.reshape(-1, 2)
    # an offset stands for its cell: a region of one offset has the variance of a cell
    return np.asarray(offsets.T @ offsets / len(offsets) + target.step_m**2 / 12 * np.eye(2))


def misfits(points: np.ndarray, target: Relief) -> np.ndarray:
    """Return the mean squared difference of heights (61, 61), m^2, at each offset in x and y of points (n, 3).

    It is NaN where fewer than half of the points would lie over the target.
    """
    taken = points[:: -(-len(points) // _MOST_POINTS)]
    cells = np.round((taken[:, :2] - target.corner) / target.step_m).astype(int)
    # a border that is as wide as the offsets: points beyond it lie over nothing
    padded = np.pad(target.heights, 2 * _HALF, constant_values=np.nan)
    near = ((cells >= -_HALF) & (cells < np.array(target.heights.shape) + _HALF)).all(axis=1)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * _HALF + 1, 2 * _HALF + 1))
    differences = windows[tuple(cells[near].T + _HALF)] - taken[near, 2].astype(np.float32)[:, None, None]
    over = np.isfinite(differences)
    count = over.sum(axis=0)
    squares = np.square(differences, out=differences).sum(axis=0, where=over, dtype=np.float64)
    return np.where(count >= _LEAST_SHARE * len(taken), squares / np.maximum(count, 1), np.nan)


def _finer(heights: np.ndarray, times: int) -> np.ndarray:
    # so many times as many rows, linear between two of them
    share = (np.arange(times, dtype=np.float32) / times)[:, None]
    between = heights[:-1, None] * (1 - share) + heights[1:, None] * share
    return np.concatenate([between.reshape(-1, heights.shape[1]), heights[-1:]])
