"""The map-to-map error: how far apart submaps lie where they overlap (after Roman and Singh 2006).

For every ordered pair of submaps (a, b) in a cell of the map we take the mean distance from a's points to b's nearest
points. A cell's error is that of its worst pair, and the map's error the root mean square over its cells. Soundings of
one surface are a spacing apart, so that even a perfect map of independent soundings has an error above zero.
"""

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd

from pointnetkl.slam.consistency import map_kernel, schemas
from pointnetkl.slam.consistency.consistency_map import Cells
from pointnetkl.slam.graph import footprint
from pointnetkl.surveys import pose
from pointnetkl.workflow import compute
from pointnetkl.workflow.errors import PointNetKLError

_SHARES = 8  # of the cells, a thread: cells do not take equal time, and with more shares threads end together


class MapToMapError(PointNetKLError):
    """A setting of the measure is out of its range."""


class MapToMap:
    """The measure for one survey's submaps, ready for many estimates of their poses."""

    def __init__(self, clouds: Sequence[np.ndarray], cell: float, thinning: int) -> None:
        """Prepare clouds (n_i, 3) in submap frames; cells of `cell` metres; every `thinning`-th point asks.

        Only the points that ask are thinned; they also decide which submaps are in a cell. The points that answer
        are not, because that would lengthen every distance.

        Raises:
            MapToMapError: the cell or the thinning is not positive.
        """
        if cell <= 0 or thinning < 1:
            raise MapToMapError(f"cell is {cell:g} m and thinning {thinning}, must be above 0 and at least 1")
        self._cell = cell
        self._asking = [cloud[::thinning] for cloud in clouds]
        self._owner = np.repeat(np.arange(len(clouds)), [len(points) for points in self._asking])
        # in the submaps' own frames, where no pose moves them
        self._targets = map_kernel.buckets(clouds)

    def __call__(self, poses: np.ndarray) -> float:
        """Return the error in metres for poses T_map_submap (n, 4, 4); NaN where no two submaps share a cell."""
        return self.cells(poses).rms

    def cells(self, poses: np.ndarray) -> Cells:
        """Return the error of every cell that submaps share at poses T_map_submap (n, 4, 4)."""
        points = np.concatenate([pose.transform(T, p) for T, p in zip(poses, self._asking, strict=True)])
        keys, cell = _unique(footprint.keys(points, self._cell))
        starts, order = map_kernel.grouped(cell, len(keys))
        worst, T_submap_map = np.empty(len(keys)), np.linalg.inv(poses)
        placed = map_kernel.Placed(starts, self._owner[order], points[order])
        arguments = (placed, T_submap_map, self._targets, worst)
        in_shares(lambda begin, end: map_kernel.worst_pairs(begin, end, *arguments), len(keys))
        shared = worst >= 0.0
        return Cells(*footprint.places(keys[shared]), worst[shared])


def thinning_table(survey: str, clouds: Sequence[np.ndarray], poses: np.ndarray, cell: float) -> pd.DataFrame:
    """Return the map-to-map error by thinning (schemas.THINNING): clouds (n_i, 3), poses (n, 4, 4), cells in metres.

    Thinning changes the measure. With fewer points that ask, submaps that barely reach into a cell are overlooked, and
    their pairs have the largest errors there; but the worst pair of a cell is known less surely, which makes it worse.
    With fewer points that answer every distance is longer, so that a map looks worse than it is.
    """
    return pd.DataFrame([_thinning_row(survey, clouds, poses, cell, thinning) for thinning in schemas.THINNINGS])


def _thinning_row(
    survey: str, clouds: Sequence[np.ndarray], poses: np.ndarray, cell: float, thinning: int
) -> dict[str, str | float]:
    asking = MapToMap(clouds, cell, thinning).cells(poses)
    both = MapToMap([cloud[::thinning] for cloud in clouds], cell, 1).cells(poses) if thinning > 1 else asking
    sizes = {"thinning": thinning, "cells": len(asking.row)}
    return {"survey": survey, **sizes, "map_to_map_m": asking.rms, "both_thinned_m": both.rms}


def in_shares(work: Callable[[int, int], None], count: int) -> None:
    """Call work(begin, end) on all of `count` cells, in threads, which run at once because kernels release the GIL."""
    bounds = np.linspace(0, count, compute.workers() * _SHARES + 1).astype(np.int64)
    with ThreadPoolExecutor(compute.workers()) as pool:
        list(pool.map(lambda share: work(*share), itertools.pairwise(bounds.tolist())))


def _unique(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # as np.unique with inverse, but it sorts cells and not points
    code, unique = pd.factorize(keys)
    order = np.argsort(unique)
    rank = np.empty(len(unique), np.int64)
    rank[order] = np.arange(len(unique))
    return unique[order], rank[code]
