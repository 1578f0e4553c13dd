"""The ground of a submap that closes a loop: its overlap with the targets, and the distribution of its slopes."""

from collections.abc import Sequence

import numpy as np

from pointnetkl.registration import gicp
from pointnetkl.slam.graph import footprint
from pointnetkl.surveys import pose
from pointnetkl.surveys.submap import Submap

_BLOCKS = 4  # of patchiness, along x and along y


def patchiness(points: np.ndarray, squared_slopes: np.ndarray) -> float:
    """Return how unevenly slopes are spread over a submap: points (n, 2 or 3), and the squared slope at each (n,).

    It is the coefficient of variation, over 4 by 4 blocks of the submap's rectangle, of the blocks' sums of squared
    slopes. Such a sum is the trace of a structure tensor, and measures what the block adds to the information of a
    registration. 0: all blocks are equal; sqrt(15) = 3.9: one block has it all. No other submap is needed, so that a
    user can compute it beforehand.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    column, row = np.minimum(_BLOCKS * (points[:, :2] - low) / (high - low), _BLOCKS - 1).astype(int).T
    sums = np.bincount(_BLOCKS * column + row, squared_slopes, _BLOCKS**2)
    return float(sums.std() / sums.mean()) if sums.any() else 0.0


def describe(
    source: Submap, T_map_source: np.ndarray, targets: Sequence[np.ndarray], cell: float, registration: gicp.Settings
) -> tuple[dict[str, float], np.ndarray]:
    """Return overlap, patchiness and outside of a submap, and the centre (3,) of the common ground, in its frame.

    `T_map_source` is its pose, `targets` are the targets' points (n, 3) in the map frame, `cell` is the size of a
    footprint's cell in metres. outside is the share of the submap's squared slopes on ground that no target has.
    """
    prepared = gicp.prepare(source.points, registration)
    slopes = (prepared.normals[:, :2].astype(np.float64) ** 2).sum(axis=1)  # squared sines, finite on a wall
    source_cells = footprint.keys(pose.transform(T_map_source, prepared.points), cell)
    target_cells = footprint.cells(np.concatenate(targets), cell)
    covered = np.isin(source_cells, target_cells)
    description = {
        "overlap": footprint.coverage(np.unique(source_cells), target_cells),
        "patchiness": patchiness(prepared.points, slopes),
        "outside": float(slopes[~covered].sum() / slopes.sum()) if slopes.any() else 0.0,
    }
    return description, prepared.points[covered if covered.any() else slice(None)].mean(axis=0)
