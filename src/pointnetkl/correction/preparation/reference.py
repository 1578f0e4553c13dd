"""A known seabed, a GeoTIFF or BAG in the survey's CRS, as points that submaps are registered on."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.correction.preparation.cut import Cut
from pointnetkl.correction.result import CorrectionError
from pointnetkl.simulation import depth_grid
from pointnetkl.surveys import pose

_MARGIN_M = 100.0  # about the survey
_MOST = 1 << 25  # cells that are read


class Reference:
    """Points of a grid in a survey's map frame, kept in a file; it can be sent to another process."""

    def __init__(self, path: Path) -> None:
        """Open the points (n, 3) that `store` has written, in order of x."""
        self.path = path
        self._points = np.load(path, mmap_mode="r")

    def __reduce__(self) -> tuple[type["Reference"], tuple[Path]]:
        """Return how another process opens the same file."""
        return Reference, (self.path,)

    def __call__(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the points (m, 3) in the rectangle from its lower to its upper corner (2,)."""
        begin, end = np.searchsorted(self._points[:, 0], [low[0], high[0]])
        strip = np.asarray(self._points[begin:end], np.float64)
        return strip[(strip[:, 1] >= low[1]) & (strip[:, 1] <= high[1])]


def store(
    grid: Path,
    crs: str,
    origin: tuple[float, float],
    bounds: tuple[np.ndarray, np.ndarray],
    spacing_m: float,
    out: Path,
) -> Reference:
    """Write a grid's cells about a survey to a file, in its map frame, no closer than the survey's points.

    Args:
        grid: a GeoTIFF or BAG.
        crs: of the survey, which the grid's must equal.
        origin: of the map frame in it.
        bounds: lower and upper corner (2,) of the survey in the map frame.
        spacing_m: of the survey's points.
        out: file to write.

    Raises:
        CorrectionError: the grid is in another CRS, or no cell of it lies under the survey.
        GridError: it cannot be read.
    """
    import rasterio
    from rasterio.windows import from_bounds

    low, high = (corner + np.array(origin) for corner in bounds)
    z, transform, down, refusal = np.empty((0, 0)), rasterio.Affine.identity(), False, ""
    with depth_grid.opened(grid) as dataset:
        name = depth_grid.crs_name(dataset)
        area = from_bounds(*(low - _MARGIN_M), *(high + _MARGIN_M), transform=dataset.transform)
        whole = rasterio.windows.Window(0, 0, dataset.width, dataset.height)
        if name != crs:
            refusal = f"is in {name or 'no CRS'} and the survey in {crs}; bring it to the survey's"
        elif not rasterio.windows.intersect(area, whole):
            refusal = "has no cell under the survey; is it of another place?"
        elif (window := area.intersection(whole)).width * window.height > _MOST:
            refusal = f"has {window.width * window.height:.3g} cells there; give a coarser grid"
        else:
            window = window.round_offsets().round_lengths()
            z = depth_grid.heights(grid, dataset, window)
            down, _ = depth_grid.sense(dataset, int(np.sum(z < 0)), int(np.isfinite(z).sum()))
            transform = dataset.window_transform(window)
    if refusal:  # an error raised above would be taken for a fault of the file
        raise CorrectionError(f"{grid}: {refusal}")
    step = max(1, round(spacing_m / abs(transform.a)))
    rows, columns = np.nonzero(np.isfinite(z[::step, ::step]))
    if not len(rows):
        raise CorrectionError(f"{grid}: has no depth under the survey; is it of another place?")
    x = transform.c + transform.a * (step * columns + 0.5)
    y = transform.f + transform.e * (step * rows + 0.5)
    height = z[step * rows, step * columns] * (-1 if down else 1)
    points = np.column_stack([x - origin[0], y - origin[1], height])
    np.save(out, points[np.argsort(points[:, 0], kind="stable")])
    return Reference(out)


def levelled(known: Reference, points: np.ndarray, spacing_m: float, out: Path) -> tuple[Reference, float]:
    """Return the reference raised by the median difference to a survey's points (n, 3), and that difference, metres.

    Levels of depths differ between datums, and a closure is of places alone.
    """
    from scipy.spatial import cKDTree

    grid = np.load(known.path)
    distance, nearest = cKDTree(grid[:, :2]).query(points[:, :2], distance_upper_bound=3 * spacing_m)
    near = np.isfinite(distance)
    if not near.any():
        return known, 0.0
    shift = float(np.median(points[near, 2] - grid[nearest[near], 2]))
    np.save(out, grid + np.array([0.0, 0.0, shift]))
    return Reference(out), shift


def under(grid: Path, metadata: Mapping[str, Any], pieces: Cut, poses: np.ndarray, folder: Path) -> Reference:
    """Return a grid as the reference of a survey cut into submaps at poses (n, 4, 4), raised to the survey's level."""
    points = np.concatenate([pose.transform(T, cloud)[::7] for T, cloud in zip(poses, pieces.clouds, strict=True)])
    corners = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    east, north = metadata["origin"]
    known = store(grid, metadata["crs"], (east, north), corners, pieces.spacing_m, folder / "reference.npy")
    known, shift = levelled(known, points, pieces.spacing_m, folder / "levelled.npy")
    print(f"{grid}: depths there are {-shift:+.2f} m against the survey's; taken out, as datums differ")
    return known
