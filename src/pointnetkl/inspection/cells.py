"""Soundings in square cells: a map of depth without holes, and the area that it covers."""

from dataclasses import dataclass

import numpy as np

_FEWEST = 3.0  # mean soundings in a cell with soundings: fewer leave holes
_AROUND = 5  # neighbours with soundings, of eight, around an empty cell that is filled
_MOST_CELLS = 900  # along the longer side
_WIDER = 1.3  # factor from one cell size to the next that is tried


@dataclass(frozen=True)
class Cells:
    """Mean depth in square cells, NaN where there is no sounding."""

    depth_m: np.ndarray  # (rows, columns), the southernmost row first
    extent: tuple[float, float, float, float]  # west, east, south, north, as in imshow
    size_m: float

    @property
    def area_m2(self) -> float:
        """The area of the cells that have soundings."""
        return float(np.isfinite(self.depth_m).sum() * self.size_m**2)


def from_points(points: np.ndarray) -> Cells | None:
    """Return points (n, 3), z up, in the smallest cells that leave few holes; None if the points span no area.

    A hole of one cell, where there is no point by chance, gets the mean of its neighbours.
    """
    if len(points) < 3:
        return None
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    if float((high - low).max()) <= 0:
        return None
    size = max(float((high - low).max()) / _MOST_CELLS, float(np.sqrt(np.prod(high - low) / len(points))) / 4)
    while True:
        shape, flat = _placed(points, low, high, size)
        if len(points) / len(np.unique(flat)) >= min(_FEWEST, len(points) / 2):
            break
        size *= _WIDER
    rows, columns = shape
    count = np.bincount(flat, minlength=rows * columns)
    total = np.bincount(flat, -points[:, 2], minlength=rows * columns)
    depth = np.divide(total, count, out=np.full(rows * columns, np.nan), where=count > 0).reshape(rows, columns)
    west, south = low.tolist()
    return Cells(_mended(depth), (west, west + columns * size, south, south + rows * size), size)


def _placed(points: np.ndarray, low: np.ndarray, high: np.ndarray, size: float) -> tuple[tuple[int, int], np.ndarray]:
    columns, rows = (np.floor((high - low) / size).astype(int) + 1).tolist()
    column, row = np.floor((points[:, :2] - low) / size).astype(int).T
    return (rows, columns), row * columns + column


def _mended(depth: np.ndarray) -> np.ndarray:
    rows, columns = depth.shape
    padded = np.pad(depth, 1, constant_values=np.nan)
    shifted = [padded[i : i + rows, k : k + columns] for i in range(3) for k in range(3) if (i, k) != (1, 1)]
    neighbours = np.stack(shifted)
    count = np.isfinite(neighbours).sum(axis=0)
    mean = np.divide(np.nansum(neighbours, axis=0), count, out=np.full(depth.shape, np.nan), where=count >= _AROUND)
    return np.where(np.isfinite(depth), depth, mean)
