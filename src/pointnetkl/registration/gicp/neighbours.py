"""Neighbour lists within a cloud, and a grid of cells in x and y for matching clouds."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

# Cells per point at most: enough for the empty corners of a diagonal track, and a bound on memory.
_CELLS_PER_POINT = 16
_RIM = 2  # empty cells on each side, because a copy reaches beyond the cloud


class Grid(NamedTuple):
    """Cells in x and y over points sorted by cell; the points of cell (c, r) begin at starts[c * rows + r]."""

    starts: np.ndarray  # (columns * rows + 1,) int32
    x0: np.float32  # corner, metres
    y0: np.float32
    cell: np.float32  # edge, metres
    columns: int
    rows: int


def nearest(points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (n, count) in metres and indices (n, count) of each point's nearest, itself among them."""
    distances, indices = cKDTree(points).query(points, np.arange(1, count + 1))
    return distances, indices


def build_grid(points: np.ndarray, spacing: float) -> tuple[Grid, np.ndarray]:
    """Return a grid of cells of `spacing` metres over points (n, 3) float32, and the order of the points by cell.

    Cells are wider than that where there would be more than 16 for every point.
    """
    x0, y0 = points[:, 0].min(), points[:, 1].min()
    width, height = float(np.ptp(points[:, 0])), float(np.ptp(points[:, 1]))
    max_cells = _CELLS_PER_POINT * len(points)
    cell = np.float32(max(spacing, np.sqrt(width * height / max_cells), max(width, height) / max_cells, 1e-6))
    x0, y0 = x0 - _RIM * cell, y0 - _RIM * cell
    column, row = ((points[:, axis] - low) * (np.float32(1) / cell) for axis, low in ((0, x0), (1, y0)))
    column, row = column.astype(np.int64), row.astype(np.int64)
    columns, rows = int(column.max()) + 1 + _RIM, int(row.max()) + 1 + _RIM
    cells = column * rows + row
    starts = np.concatenate([[0], np.cumsum(np.bincount(cells, minlength=columns * rows))]).astype(np.int32)
    return Grid(starts, x0, y0, cell, columns, rows), np.argsort(cells, kind="stable")
