"""The consistency map: the map-to-map error of each cell, as a raster in the survey's own coordinates.

A survey has one GeoTIFF with a band for each trajectory. All bands lie on one grid, so that a GIS can show them in turn
and subtract one from another.
"""

import json
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError

_LARGEST = 1 << 28  # cells of a raster, a gigabyte
# WKT of the CRS "local", for a survey whose place on the earth is not known
_LOCAL = 'LOCAL_CS["local",UNIT["metre",1],AXIS["east",EAST],AXIS["north",NORTH]]'


class ConsistencyError(PointNetKLError):
    """A consistency map cannot be written or read."""


class Cells(NamedTuple):
    """The k cells of a map that two or more submaps share, by column and then row."""

    column: np.ndarray  # (k,) int64, counted eastwards: column 0 begins at the map frame's origin
    row: np.ndarray  # (k,) int64, northwards
    error_m: np.ndarray  # (k,) of the worst pair of submaps

    @property
    def rms(self) -> float:
        """Return the root mean square of the errors, metres; NaN without cells."""
        return rms(self.error_m)


@dataclass(frozen=True)
class Frame:
    """The place of a survey's map frame on the earth, and the size of the cells."""

    origin: tuple[float, float]  # easting and northing of the map frame's origin, metres
    crs: str  # projected, or "local"
    cell_m: float


@dataclass(frozen=True)
class Extent:
    """The cells that a raster spans."""

    column: int  # the westernmost
    row: int  # the southernmost
    columns: int
    rows: int


@dataclass(frozen=True)
class Rasters:
    """A survey's errors in metres (rows, columns) by trajectory, north up; NaN where no two submaps overlap."""

    errors: Mapping[str, np.ndarray]
    extent: tuple[float, float, float, float]  # west, east, south, north, metres in the survey's CRS


def rms(errors: np.ndarray) -> float:
    """Return the root mean square of cells' errors (k,); NaN without cells."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else float("nan")


def read_origin(path: Path) -> tuple[tuple[float, float], str]:
    """Return the map frame's origin (easting, northing in metres) and its CRS, which may be "local", of a pings file.

    Raises:
        ConsistencyError: the file has no origin or no CRS.
        ArtifactError: the file is missing or damaged.
    """
    metadata = artifacts.table_metadata(path)
    if len(metadata.get("origin", ())) != 2 or "crs" not in metadata:
        raise ConsistencyError(f"{path}: must name the crs and origin of its map frame; run dvc repro ingest")
    east, north = metadata["origin"]
    return (float(east), float(north)), str(metadata["crs"])


def cells_by_trajectory(trajectories: pd.DataFrame, measure: Callable[[np.ndarray], Cells]) -> dict[str, Cells]:
    """Return what `measure` makes of the poses (n, 4, 4) of each trajectory in a table benchmark.schemas.TRAJECTORIES.

    The poses are levelled: the table lacks a solution's roll and pitch, which are some ten-thousandths of a radian.
    """
    return {
        str(name): measure(submap.poses_from_table(rows.sort_values("submap")))
        for name, rows in trajectories.groupby("which", sort=False)
    }


def extent(trajectories: Iterable[Cells]) -> Extent:
    """Return the extent that holds all cells of some trajectories; one cell, at the origin, if they have none.

    Raises:
        ConsistencyError: the extent is too large for a raster.
    """
    occupied = [cells for cells in trajectories if len(cells.row)]
    if not occupied:
        return Extent(0, 0, 1, 1)
    column, row = (min(int(cells[axis].min()) for cells in occupied) for axis in (0, 1))
    columns = max(int(cells.column.max()) for cells in occupied) - column + 1
    rows = max(int(cells.row.max()) for cells in occupied) - row + 1
    if columns * rows > _LARGEST:
        raise ConsistencyError(
            f"the submaps of all trajectories spread over {columns} x {rows} cells, and a raster has at most"
            f" {_LARGEST}; raise slam.map_cell_m, or find which method's poses are lost"
        )
    return Extent(column, row, columns, rows)


def raster(cells: Cells, extent: Extent) -> np.ndarray:
    """Return errors in metres (rows, columns) float32, the northernmost row first, NaN where no two submaps overlap."""
    image = np.full((extent.rows, extent.columns), np.nan, np.float32)
    image[extent.row + extent.rows - 1 - cells.row, cells.column - extent.column] = cells.error_m
    return image


def write(path: Path, cells: Mapping[str, Cells], frame: Frame, metadata: Mapping[str, Any]) -> None:
    """Write trajectories' cells as a GeoTIFF with a band for each, named after the trajectory.

    Equal input gives equal bytes.

    Raises:
        ConsistencyError: the CRS is unknown, or the raster too large.
        ArtifactError: the file cannot be written.
    """
    import rasterio  # slow to import
    from rasterio.io import MemoryFile

    whole = extent(cells.values())
    crs = _crs(path, frame.crs)
    west = frame.origin[0] + whole.column * frame.cell_m
    north = frame.origin[1] + (whole.row + whole.rows) * frame.cell_m
    transform = rasterio.Affine(frame.cell_m, 0.0, west, 0.0, -frame.cell_m, north)
    shape = {"width": whole.columns, "height": whole.rows, "count": len(cells), "dtype": "float32"}
    layout = {"compress": "deflate", "predictor": 3, "interleave": "band"}
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", crs=crs, transform=transform, nodata=np.nan, **shape, **layout) as file:
            for band, (name, trajectory) in enumerate(cells.items(), 1):
                file.write(raster(trajectory, whole), band)
                file.set_band_description(band, name)
                file.set_band_unit(band, "m")
            file.update_tags(pointnetkl=json.dumps(metadata, sort_keys=True))
        artifacts.write_bytes(path, bytes(memory.read()))


def read(path: Path, trajectories: Collection[str]) -> Rasters:
    """Read the rasters of some trajectories; those without a band in the file are left out.

    Raises:
        ConsistencyError: the file cannot be read.
    """
    import rasterio

    try:
        with rasterio.open(path) as file:
            bands = {name: file.read(i) for i, name in enumerate(file.descriptions, 1) if name in trajectories}
            bounds = file.bounds
    except rasterio.errors.RasterioError as error:
        reason = " ".join(str(error).split())[:120]
        raise ConsistencyError(f"{path}: is not a GeoTIFF that can be read ({reason}); run dvc repro slam") from error
    errors = {name: bands[name] for name in trajectories if name in bands}
    return Rasters(errors, (bounds.left, bounds.right, bounds.bottom, bounds.top))


def _crs(path: Path, name: str) -> Any:
    import rasterio

    try:
        return rasterio.CRS.from_string(_LOCAL if name == "local" else name)
    except rasterio.errors.CRSError as error:
        raise ConsistencyError(f"{path}: the survey's crs {name!r} is unknown; name another, run ingest") from error
