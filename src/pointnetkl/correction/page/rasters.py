"""The maps beside the page, small enough to draw, however large the files are."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl.correction.result import CorrectionError
from pointnetkl.workflow.artifacts import one_line

CELLS = 520  # along the longer side, at most


@dataclass(frozen=True)
class Raster:
    """A band of a map, thinned to be drawn."""

    values: np.ndarray  # (rows, columns), the southernmost row first; NaN where there is nothing
    extent: tuple[float, float, float, float]  # west, east, south, north, metres in the survey's CRS

    @property
    def corners(self) -> np.ndarray:
        """Return the corners [[x, y], [x, y]] of the cells that have a value, metres."""
        rows, columns = (np.flatnonzero(np.isfinite(self.values).any(axis=axis)) for axis in (1, 0))
        west, east, south, north = self.extent
        cell = np.array([east - west, north - south]) / self.values.shape[::-1]
        low, high = np.array([columns[0], rows[0]]), np.array([columns[-1], rows[-1]]) + 1
        return np.array([west, south]) + np.stack([low, high]) * cell


def read(path: Path, band: str) -> Raster | None:
    """Return a band of a GeoTIFF by its name; None where there is no file, or no value in it.

    Only averages of cells come into memory, a strip of the file at a time.

    Raises:
        CorrectionError: the file cannot be read, or lacks the band.
    """
    import rasterio
    from rasterio.enums import Resampling

    if not path.exists():
        return None
    try:
        with rasterio.open(path) as file:
            index = _index(path, file.descriptions, band)
            shrink = max(1.0, max(file.shape) / CELLS)
            shape = tuple(max(1, round(n / shrink)) for n in file.shape)
            values = file.read(index, out_shape=shape, resampling=Resampling.average, masked=True)
            bounds = file.bounds
    except rasterio.errors.RasterioError as error:
        raise CorrectionError(f"{path}: cannot be read ({one_line(error)}); run the correction again") from error
    values = values.astype(np.float64).filled(np.nan)[::-1]
    extent = (bounds.left, bounds.right, bounds.bottom, bounds.top)
    return Raster(values, extent) if np.isfinite(values).any() else None


def _index(path: Path, names: Sequence[str | None], band: str) -> int:
    if band not in names:
        raise CorrectionError(f"{path}: has no band {band}; run the correction again")
    return names.index(band) + 1
