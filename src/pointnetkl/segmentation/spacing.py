"""Spacing of points: square cells, one point drawn from each, halves of a submap, and points that stand alone."""

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

_SIGMAS = 6.0  # from the median of its block; a sounding farther off is suspect
_BLOCK = 3  # cells along a block's edge
_COMPANY = 2  # neighbours that a suspect needs to be kept
_TO_SIGMA = 1.4826  # from a median absolute deviation, for a Gaussian


def cells(points: np.ndarray, edge: float) -> np.ndarray:
    """Return the number (n,) of the square cell that holds each point, on a grid through the frame's origin.

    Numbers grow with x, then y; `points` are (n, 2 or 3), in the unit of `edge`.
    """
    if not len(points):
        return np.empty(0, np.int64)
    corner = np.floor(points[:, :2] / edge).astype(np.int64)
    corner -= corner.min(axis=0)
    return corner[:, 0] * (corner[:, 1].max() + 1) + corner[:, 1]


def thin(points: np.ndarray, edge: float, rng: np.random.Generator) -> np.ndarray:
    """Return the rows of one point drawn at random from each square cell, in the order of the cells."""
    occupied, counts, order = _grouped(cells(points, edge))
    drawn = np.floor(rng.random(len(counts)) * counts).astype(np.int64)
    return order[occupied + drawn]


def between_neighbours(points: np.ndarray) -> float:
    """Return the median distance from a point (n, 3) to its nearest neighbour."""
    return float(np.median(cKDTree(points).query(points, 2)[0][:, 1]))


def alternate(points: np.ndarray, edge: float, rng: np.random.Generator) -> np.ndarray:
    """Return whether (n,) each point (n, 3) is in the second half: of each square cell, every other one at random.

    A submap's halves are the same ground twice, from points that are not the same. Those of a swath are alternate
    pings, each a pass of its own over the ground between the other's; these are for points without pings. Where the
    points are single soundings that is as good. Where they are nodes of a gridded surface, neighbours share soundings,
    the halves err together, and a label of `label.copy: split` is too small.

    A cell of `edge` that holds two points or more is in both halves; one that holds a single point is in either.
    """
    shuffled = rng.permutation(len(points))
    cell = cells(points, edge)[shuffled]
    counts, order = np.unique(cell, return_counts=True)[1], np.argsort(cell, kind="stable")
    rank = np.arange(len(points)) - np.repeat(np.cumsum(counts) - counts, counts)
    second = np.empty(len(points), bool)
    second[shuffled[order]] = (rank + np.repeat(rng.integers(0, 2, len(counts)), counts)) % 2 == 1
    return second


def outlying(points: np.ndarray, edge: float) -> np.ndarray:
    """Return whether (n,) each sounding (n, 3) stands alone, as gross errors do and seabed does not.

    A sounding is suspect when it lies more than 6 robust standard deviations from the median height of its block of
    3 x 3 cells. A rock or a wall makes suspects too, but several: a suspect with two others within one cell's edge is
    kept. A sounding far from all others in the plane stands alone as well.
    """
    if len(points) <= _COMPANY:
        return np.zeros(len(points), bool)
    block = cells(points, _BLOCK * edge)
    return _blunders(points, block, edge) | _remote(points, block, _BLOCK * edge)


def _blunders(points: np.ndarray, block: np.ndarray, edge: float) -> np.ndarray:
    distance = np.abs(points[:, 2] - _median_by(block, points[:, 2]))
    sigma = _TO_SIGMA * _median_by(block, distance)
    # few soundings may happen to lie closer together than any sonar measures
    suspect = distance > _SIGMAS * np.maximum(sigma, max(float(np.median(sigma)), 1e-3 * edge))
    suspect[suspect] = ~_in_company(points[suspect], points[suspect], edge)
    return suspect


def _remote(points: np.ndarray, block: np.ndarray, distance: float) -> np.ndarray:
    _, number, counts = np.unique(block, return_inverse=True, return_counts=True)
    remote = np.asarray(counts[number] <= _COMPANY)
    if remote.any():
        remote[remote] = ~_in_company(points[remote, :2], points[:, :2], distance)
    return remote


def _in_company(queries: np.ndarray, points: np.ndarray, distance: float) -> np.ndarray:
    """Return whether (k,) each of the queries, points of the cloud, has enough other points within the distance."""
    if len(points) <= _COMPANY:
        return np.zeros(len(queries), bool)
    farthest = cKDTree(points).query(queries, k=_COMPANY + 1)[0][:, -1]  # the first is the point itself
    return np.asarray(farthest <= distance)


def _grouped(group: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return, for rows put in order of their group: where each group starts, its size, and that order."""
    order = np.argsort(group, kind="stable")
    _, starts, counts = np.unique(group[order], return_index=True, return_counts=True)
    return starts, counts, order


def _median_by(group: np.ndarray, values: np.ndarray) -> np.ndarray:
    return pd.Series(values).groupby(group).transform("median").to_numpy()
