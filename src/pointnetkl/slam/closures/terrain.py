"""The ground of a submap that closes a loop: how much of it its targets have, and how its slopes are spread over it."""

from collections.abc import Sequence

import numpy as np

from pointnetkl.registration import gicp
from pointnetkl.slam.graph import footprint
from pointnetkl.surveys import pose
from pointnetkl.surveys.submap import Submap

_BLOCKS = 4  # of patchiness, along x and along y


def patchiness(points: np.ndarray, squared_slopes: np.ndarray) -> float:
    """Return how unevenly slopes are spread over a submap: points (n, 2 or 3), the squared slope at each (n,).

    The submap's rectangle has 4 by 4 blocks; the coefficient of variation of the blocks' sums of squared slopes, which
    are the traces of their structure tensors: what each adds to the registration's information. 0: all the same;
    sqrt(15) = 3.9: all of it in one block. It needs no other submap, so that a user can tell it beforehand.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    column, row = np.minimum(_BLOCKS * (points[:, :2] - low) / (high - low), _BLOCKS - 1).astype(int).T
    sums = np.bincount(_BLOCKS * column + row, squared_slopes, _BLOCKS**2)
    return float(sums.std() / sums.mean()) if sums.any() else 0.0


def describe(
    one: Submap, T: np.ndarray, around: Sequence[np.ndarray], cell: float, registration: gicp.Settings
) -> tuple[dict[str, float], np.ndarray]:
    """Return overlap, patchiness and outside of a submap, and the middle (3,) of the common ground, in its frame.

    `T` is its pose, `around` its targets' points (n, 3) in the map frame; `cell` metres is a footprint's. outside is
    the share of the submap's squared slopes on ground that no target has.
    """
    prepared = gicp.prepare(one.points, registration)
    slopes = (prepared.normals[:, :2].astype(np.float64) ** 2).sum(axis=1)  # squared sines: a wall's stays finite
    mine = footprint.keys(pose.transform(T, prepared.points), cell)
    theirs = footprint.cells(np.concatenate(around), cell)
    covered = np.isin(mine, theirs)
    found = {
        "overlap": footprint.coverage(np.unique(mine), theirs),
        "patchiness": patchiness(prepared.points, slopes),
        "outside": float(slopes[~covered].sum() / slopes.sum()) if slopes.any() else 0.0,
    }
    return found, prepared.points[covered if covered.any() else slice(None)].mean(axis=0)
