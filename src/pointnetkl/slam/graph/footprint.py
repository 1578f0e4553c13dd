"""Footprints of submaps, as occupied cells of a map grid, and how much of one another covers."""

import numpy as np


def cells(points: np.ndarray, cell: float) -> np.ndarray:
    """Return the cells that hold points (n, 2 or 3) in the map frame, as sorted unique keys; `cell` in metres."""
    return np.unique(keys(points, cell))


def keys(points: np.ndarray, cell: float) -> np.ndarray:
    """Return the key of the cell of each point (n, 2 or 3): an int64 of its column and row."""
    column, row = np.floor(points[:, :2].T / cell).astype(np.int64)
    return (column << 32) + row  # one to one while |row| < 2^31


def places(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns and rows of cells by their keys."""
    row = ((keys + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)  # the lower half of the key, sign extended
    return (keys - row) >> 32, row


def coverage(covered: np.ndarray, covering: np.ndarray) -> float:
    """Return the share of one footprint's cells that another one has too, by their keys (see `cells`)."""
    return float(np.mean(within(covered, covering)))


def within(keys: np.ndarray, covering: np.ndarray) -> np.ndarray:
    """Return whether (n,) each key is among those of a footprint, which has one at least."""
    return np.asarray(covering[np.minimum(np.searchsorted(covering, keys), len(covering) - 1)] == keys)


class Footprints:
    """The footprints of the submaps in a map so far, in the order they were added."""

    def __init__(self, cell: float) -> None:
        """Start an empty map with cells of `cell` metres."""
        self._cell = cell
        self._cells: list[np.ndarray] = []
        self._bounds: list[np.ndarray] = []

    def add(self, points: np.ndarray) -> None:
        """Add the footprint of points (n, 3) in the map frame."""
        self._cells.append(cells(points, self._cell))
        self._bounds.append(_bounds(points))

    def covering(self, points: np.ndarray, share: float, among: int) -> np.ndarray:
        """Return which of the first `among` footprints cover at least `share` of the footprint of points (n, 3)."""
        if among < 1:
            return np.empty(0, np.int64)
        footprint, (low_x, low_y, high_x, high_y) = cells(points, self._cell), _bounds(points)
        low, high = np.hsplit(np.array(self._bounds[:among]), 2)
        # most submaps of a long survey lie elsewhere, and we can skip their cells
        near = ((low <= [high_x, high_y]) & (high >= [low_x, low_y])).all(axis=1)
        indices = [k for k in np.flatnonzero(near) if coverage(footprint, self._cells[k]) >= share]
        return np.array(indices, np.int64)


def _bounds(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])
