"""How far the depths disagree that passes over the same ground give: the rms over cells, and by cell."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pointnetkl.slam.graph import footprint
from pointnetkl.surveys import pose

CELL_SPACINGS = 3.0  # edge of the cells: a pass has some nine points in each
_FEWEST = 5  # points of a pass in a cell, for a mean
_OFFSETS = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))  # of the cells, in their edges: where edges lie is chance


@dataclass(frozen=True)
class Cells:
    """The cells that two or more passes share."""

    xy: np.ndarray  # (k, 2) their middles, metres in the map frame
    difference_m: np.ndarray  # (k,) from the shallowest pass's height to the deepest's

    @property
    def rms_m(self) -> float:
        """Return the rms difference, metres; NaN without cells."""
        return float(np.sqrt(np.mean(self.difference_m**2))) if len(self.difference_m) else float("nan")


def measure(clouds: Sequence[np.ndarray], poses: np.ndarray, passes: np.ndarray, spacing_m: float) -> Cells:
    """Return the cells that passes share, on four grids that lie half a cell apart.

    A pass's height is that at the middle of the cell: the mean of its points, carried there along the slope that the
    passes have in common. Passes have their points at other places, and on a slope their plain means would differ.

    Args:
        clouds: n submaps' points (n_i, 3), in their own frames.
        poses: T_map_submap (n, 4, 4).
        passes: (n,) the pass that each submap is of.
        spacing_m: of the points.
    """
    points = np.concatenate([pose.transform(T, cloud) for T, cloud in zip(poses, clouds, strict=True)])
    of_pass = np.repeat(passes, [len(cloud) for cloud in clouds])
    cell = CELL_SPACINGS * spacing_m
    parts = [_on_grid(points + np.array([dx * cell, dy * cell, 0.0]), of_pass, cell) for dx, dy in _OFFSETS]
    places = [xy - np.array(offset) * cell for (xy, _), offset in zip(parts, _OFFSETS, strict=True)]
    return Cells(np.concatenate(places), np.concatenate([difference for _, difference in parts]))


def _on_grid(points: np.ndarray, passes: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles (k, 2) of the cells that passes share, and how far these are apart there."""
    keys, number = np.unique(footprint.keys(points, cell), return_inverse=True)
    column, row = footprint.places(keys)
    middles = cell * (np.column_stack([column, row]) + 0.5)
    order = np.lexsort((passes, number))
    number, local = number[order], points[order]
    local[:, :2] -= middles[number]
    begins = np.flatnonzero(np.diff(number, prepend=-1) | np.diff(passes[order], prepend=passes.min() - 1))
    size = np.diff(begins, append=len(number))
    means = np.add.reduceat(local, begins) / size[:, None]
    slope = _slopes(local - np.repeat(means, size, axis=0), number, len(keys))
    height = means[:, 2] - (slope[number[begins]] * means[:, :2]).sum(axis=1)
    enough = size >= _FEWEST
    return _spread(middles, number[begins][enough], height[enough])


def _slopes(deviations: np.ndarray, number: np.ndarray, count: int) -> np.ndarray:
    """Return the slope (count, 2) in each cell from the deviations (n, 3) of points from their pass's mean there."""

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(number, values, count)

    x, y, z = deviations.T
    xx, xy, yy, xz, yz = total(x * x), total(x * y), total(y * y), total(x * z), total(y * z)
    determinant = xx * yy - xy**2
    spread = determinant > 1e-3 * (xx * yy) + 1e-12  # points in a row have no slope across it
    slope = np.column_stack([yy * xz - xy * yz, xx * yz - xy * xz]) / np.where(spread, determinant, 1.0)[:, None]
    return np.where(spread[:, None], slope, 0.0)


def _spread(middles: np.ndarray, number: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of which there are two heights or more, and the range of those; rows are in order of cells."""
    if not len(number):
        return np.empty((0, 2)), np.empty(0)
    begins = np.flatnonzero(np.diff(number, prepend=-1))
    several = np.diff(begins, append=len(number)) > 1
    apart = np.maximum.reduceat(height, begins) - np.minimum.reduceat(height, begins)
    return middles[number[begins[several]]], apart[several]
