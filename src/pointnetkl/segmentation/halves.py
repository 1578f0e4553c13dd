"""Halves of a submap whose points have no pings: the same ground twice, from points that are not the same.

The halves of a swath are alternate pings, each a pass of its own over the ground between the other's. Points without
pings alternate at random within each cell. Where they are single soundings that is as good; where they are nodes of a
gridded surface, neighbours share soundings, the halves err together, and a label of `label.copy: split` is too small.
"""

import numpy as np

from pointnetkl.segmentation import spacing


def alternate(points: np.ndarray, edge: float, rng: np.random.Generator) -> np.ndarray:
    """Return which points (n, 3) are in the second half: of each square cell's, in random order, every other one.

    So a cell of `edge` that holds two points or more is in both halves; one that holds a single point is in either.
    """
    shuffled = rng.permutation(len(points))
    counts, order = _by_cell(spacing.cells(points, edge)[shuffled])
    rank = np.arange(len(points)) - np.repeat(np.cumsum(counts) - counts, counts)
    second = np.empty(len(points), bool)
    second[shuffled[order]] = (rank + np.repeat(rng.integers(0, 2, len(counts)), counts)) % 2 == 1
    return second


def _by_cell(cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how many rows each cell has, and the rows in order of their cells."""
    counts = np.unique(cell, return_counts=True)[1]
    return counts, np.argsort(cell, kind="stable")
