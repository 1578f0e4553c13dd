"""Rasters of the seabed to draw, in metres."""

import numpy as np
from matplotlib.colors import LightSource

DEPTHS = "viridis_r"  # perceptually even; deep is dark
_CELLS = 260  # of a depth map along its longer side, at most
_SPACINGS = 2.5  # between nearest neighbours, to a cell: fewer leave holes


def raster(
    points: np.ndarray, spacing: float, corners: np.ndarray
) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Return the mean depth of points (n, 3) in square cells, NaN where there are none, and its extent, metres.

    The map is as large as `corners`, [[x, y], [x, y]], and the points must lie between them. A cell is some point
    `spacing`s wide, so that a full swath has no holes, or wider on a large map.
    """
    low, high = corners
    size = max(float((high - low).max()) / _CELLS, _SPACINGS * spacing)
    columns, rows = (int(n) for n in np.floor((high - low) / size) + 1)
    column, row = np.floor((points[:, :2] - low) / size).astype(int).T
    flat = row * columns + column
    count = np.bincount(flat, minlength=rows * columns)
    total = np.bincount(flat, -points[:, 2], minlength=rows * columns)
    depth = np.divide(total, count, out=np.full(rows * columns, np.nan), where=count > 0).reshape(rows, columns)
    return depth, (float(low[0]), float(low[0] + columns * size), float(low[1]), float(low[1] + rows * size))


def shade(depth: np.ndarray, extent: tuple[float, float, float, float]) -> np.ndarray:
    """Return how bright a raster's cells are, 0 to 1, in light from the north-west."""
    # where a cliff takes all the colours, flat ground still shows its forms
    cell = (extent[1] - extent[0]) / depth.shape[1]
    # turned over, because LightSource takes the first row for the northernmost
    return np.asarray(LightSource(315, 40).hillshade(-depth[::-1], vert_exag=4, dx=cell, dy=cell))[::-1]
