"""A seabed from a real grid, a GeoTIFF or BAG of depths, with added roughness below the size of its cells."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage, signal

from pointnetkl.simulation import depth_grid, noise
from pointnetkl.simulation.depth_grid import GridError

_MOST_CELLS = 1 << 24  # that are read; of a larger grid those about the survey's centre


@dataclass(frozen=True)
class Grid:
    """Depths of a raster, interpolated by cubic splines between the centres of its cells."""

    crs: str
    path: Path
    spline: np.ndarray  # (rows, columns) coefficients
    valid: np.ndarray  # (rows, columns) bool: has a depth
    corner: tuple[float, float]  # x, y of the outer corner of the first cell
    cell: tuple[float, float]  # its size in x and in y, metres; y negative in a raster whose first row is north
    roughness_m: float
    seed: int
    centre: tuple[float, float] | None  # of the survey; None: the most central place with room

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return z (n,) metres at projected coordinates x, y (n,); NaN where the grid has no depth."""
        row = (y - self.corner[1]) / self.cell[1] - 0.5
        column = (x - self.corner[0]) / self.cell[0] - 0.5
        z = ndimage.map_coordinates(self.spline, [row, column], order=3, prefilter=False, mode="mirror")
        valid = ndimage.map_coordinates(self.valid.astype(np.uint8), [row, column], order=0, mode="constant")
        if self.roughness_m > 0:
            # the roughness that the grid averaged away: two octaves shorter than twice its cell
            size = abs(self.cell[0])
            z = z + self.roughness_m * noise.field(x - self.corner[0], y - self.corner[1], self.seed, size, 2)
        return np.where(valid > 0, z, np.nan)

    def place(self, length_m: float, width_m: float, azimuth_rad: float) -> tuple[float, float]:
        """Return the centre of a survey of this size that lies within the valid area, as central as possible.

        Raises:
            GridError: there is no such place, or the centre of the settings is none.
        """
        if self.centre is not None:
            return self._checked(self.centre, length_m, width_m, azimuth_rad)
        shape = _rectangle(length_m, width_m, azimuth_rad, self.cell)
        if shape.shape[0] > self.valid.shape[0] or shape.shape[1] > self.valid.shape[1]:
            raise GridError(self._no_room(length_m, width_m))
        covered = signal.fftconvolve(self.valid.astype(float), shape[::-1, ::-1], mode="valid")
        rows, columns = np.nonzero(covered > shape.sum() - 0.5)
        if len(rows) == 0:
            raise GridError(self._no_room(length_m, width_m))
        middle = np.argwhere(self.valid).mean(axis=0)
        row, column = rows + (shape.shape[0] - 1) / 2, columns + (shape.shape[1] - 1) / 2
        best = int(np.argmin((row - middle[0]) ** 2 + (column - middle[1]) ** 2))
        x = self.corner[0] + (column[best] + 0.5) * self.cell[0]
        return float(x), float(self.corner[1] + (row[best] + 0.5) * self.cell[1])

    def _checked(
        self, centre: tuple[float, float], length_m: float, width_m: float, azimuth_rad: float
    ) -> tuple[float, float]:
        rows, columns = np.nonzero(_rectangle(length_m, width_m, azimuth_rad, self.cell))
        x = centre[0] + (columns - columns.max() / 2) * self.cell[0]
        y = centre[1] + (rows - rows.max() / 2) * self.cell[1]
        if not np.isfinite(self(x, y)).all():
            raise GridError(
                f"{self.path}: has no depth under a part of a survey of {length_m:.0f} m by {width_m:.0f} m about"
                f" {centre[0]:.0f}, {centre[1]:.0f}; leave out centre_m to have a place chosen"
            )
        return centre

    def _no_room(self, length_m: float, width_m: float) -> str:
        area = self.valid.sum() * abs(self.cell[0] * self.cell[1]) / 1e6
        return (
            f"{self.path}: its valid area of {area:.3g} km2 has no room for a survey of {length_m:.0f} m by"
            f" {width_m:.0f} m; lower line_length_m, lines or altitude_m, or turn azimuth_deg"
        )


def read(
    path: Path,
    roughness_m: float = 0.0,
    seed: int = 0,
    sunk_m: float = 0.0,
    centre: tuple[float, float] | None = None,
) -> Grid:
    """Read a GeoTIFF or BAG of heights in metres, lowered by `sunk_m`; depths (`depth_grid.sense`) change their sign.

    Of a grid of more than 16.7 million cells those about the centre are read.

    Raises:
        GridError: the file is neither, or not a north-up grid in a projected CRS in metres; or it is too large to read
            without a centre.
    """
    with depth_grid.opened(path) as dataset:
        _check(path, dataset)
        window = _window(path, dataset, centre)
        z = depth_grid.heights(path, dataset, window)
        transform = dataset.transform if window is None else dataset.window_transform(window)
        crs, valid = depth_grid.crs_name(dataset), np.isfinite(z)
        down, _ = depth_grid.sense(dataset, int(np.sum(z < 0)), int(np.sum(valid)))
    if valid.mean() < 1e-6 or min(z.shape) < 4:
        raise GridError(f"{path}: has no depths")
    if down:
        z = -z
    return Grid(
        crs=crs,
        path=path,
        spline=ndimage.spline_filter(_filled(z - sunk_m, valid), order=3, mode="mirror"),
        valid=valid,
        corner=(transform.c, transform.f),
        cell=(transform.a, transform.e),
        roughness_m=roughness_m,
        seed=seed,
        centre=centre,
    )


def _check(path: Path, dataset: Any) -> None:
    crs, transform = depth_grid.level_crs(dataset), dataset.transform
    if crs is None or not crs.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info):
        name = crs.name if crs else None
        raise GridError(f"{path}: its CRS is {name}, must be projected, in metres; reproject it, for example to UTM")
    if transform.b or transform.d:
        raise GridError(f"{path}: is rotated; resample it to a north-up grid")
    if not (np.isfinite(transform[:6]).all() and 0 < abs(transform.a) < 1e5 and 0 < abs(transform.e) < 1e5):
        raise GridError(f"{path}: its cells of {transform.a:.6g} by {transform.e:.6g} m are none; its head is damaged")
    if depth_grid.is_variable(dataset):
        raise GridError(
            f"{path}: is a BAG of variable resolution, whose own cells are only an index; resample it to one"
            " resolution, for example by gdal_translate -oo MODE=RESAMPLED_GRID"
        )


def _window(path: Path, dataset: Any, centre: tuple[float, float] | None) -> Any:
    """Return the window of a grid to read; None for the whole grid."""
    if dataset.width * dataset.height <= _MOST_CELLS:
        return None
    if centre is None:
        raise GridError(
            f"{path}: has {dataset.width} x {dataset.height} cells, more than the {_MOST_CELLS} that are read at once;"
            " set centre_m to read those about it, or cut it"
        )
    from rasterio.windows import Window

    edge = int(np.sqrt(_MOST_CELLS))
    transform = dataset.transform
    column, row = (centre[0] - transform.c) / transform.a, (centre[1] - transform.f) / transform.e
    if not (0 <= column < dataset.width and 0 <= row < dataset.height):
        raise GridError(f"{path}: centre_m {centre[0]:.0f}, {centre[1]:.0f} lies outside it")
    # a narrow grid is read over a longer stretch
    width = min(dataset.width, max(edge, _MOST_CELLS // dataset.height))
    height = min(dataset.height, _MOST_CELLS // width)
    first_column = min(max(0, int(column) - width // 2), dataset.width - width)
    first_row = min(max(0, int(row) - height // 2), dataset.height - height)
    return Window(first_column, first_row, width, height)


def _filled(z: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the grid with holes filled from the nearest depth, because splines do not allow NaN."""
    nearest = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return np.asarray(z[tuple(nearest)])


def _rectangle(length_m: float, width_m: float, azimuth_rad: float, cell: tuple[float, float]) -> np.ndarray:
    """Return the cells that a rotated rectangle covers, with one cell around it, as 0 and 1."""
    c, s = np.cos(azimuth_rad), np.sin(azimuth_rad)
    margin = max(abs(cell[0]), abs(cell[1]))
    a, b = length_m / 2 + margin, width_m / 2 + margin
    half_x, half_y = abs(c) * a + abs(s) * b, abs(s) * a + abs(c) * b
    columns, rows = (int(np.ceil(half / abs(step))) for half, step in ((half_x, cell[0]), (half_y, cell[1])))
    y, x = np.arange(-rows, rows + 1)[:, None] * cell[1], np.arange(-columns, columns + 1) * cell[0]
    return ((abs(c * x + s * y) <= a) & (abs(c * y - s * x) <= b)).astype(float)
