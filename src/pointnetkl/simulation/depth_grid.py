"""Grids of depths in GeoTIFF or BAG files: their description and their heights, checked against damage."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.workflow.errors import PointNetKLError

SUFFIXES = (".tif", ".tiff", ".bag")

_DRIVERS = {b"II*\0": "GTiff", b"MM\0*": "GTiff", b"II+\0": "GTiff", b"MM\0+": "GTiff", b"\x89HDF": "BAG"}
_DEEPEST_M = 12_000.0
_FEET = ("ft", "foot", "feet", "us survey foot", "us-ft")
_LARGEST_BLOCK = 1 << 26  # cells that GDAL must hold at once
_DRYING = 0.05  # greatest share of a grid of depths that is above the datum, with depths below zero
_STRIPE = 1 << 22  # cells that are read at once


class GridError(PointNetKLError):
    """A grid cannot be read, or has no room for the survey."""


@dataclass(frozen=True)
class Description:
    """Description of a grid."""

    format: str  # GeoTIFF or BAG
    rows: int
    columns: int
    cell_m: tuple[float, float]  # width and height of a cell, in the unit of its CRS
    crs: str  # EPSG:n where it has a code, else WKT; empty where the file has none
    valid: int  # cells that have a depth
    depth_min_m: float  # NaN where no cell has one
    depth_max_m: float
    down: bool  # whether its numbers are depths
    vertical: str  # the sense of its numbers, and the reason to think so
    variable: bool  # a BAG whose cells hold grids of their own; the description is of the coarse grid


def begins(head: bytes) -> bool:
    """Return whether the first bytes of a file are those of a TIFF, or of HDF5, the container of a BAG."""
    return head[:4] in _DRIVERS


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a grid for reading.

    Raises:
        GridError: the file is neither GeoTIFF nor BAG, or is damaged, or reading it fails while it is open.
    """
    import rasterio  # imported here, because it is slow to import and most surveys have no grid

    try:
        with path.open("rb") as file:
            driver = _DRIVERS.get(file.read(4))
        if driver is None:
            raise GridError(f"{path}: is not a GeoTIFF or BAG that can be read (by its first bytes it is another file)")
        # GDAL's warnings are ignored, because our checks find the same faults
        with (
            warnings.catch_warnings(action="ignore"),
            rasterio.Env(GTIFF_REPORT_COMPD_CS=True),  # the vertical CRS as well
            rasterio.open(path, driver=driver) as dataset,
        ):
            height, width = dataset.block_shapes[0]
            if height * width > _LARGEST_BLOCK or dataset.count < 1:
                raise GridError(f"{path}: its blocks of {height} x {width} cells are too large; it is damaged")
            yield dataset
    except GridError:
        raise
    except Exception as error:  # GDAL, HDF5 and PROJ raise errors of many kinds
        reason = " ".join(str(error).split())[:120]
        raise GridError(f"{path}: is not a GeoTIFF or BAG that can be read ({reason})") from error


def heights(path: Path, dataset: Any, window: Any = None) -> np.ndarray:
    """Return z (rows, columns) in metres, float64, NaN where there is none; positive up or down as in the file.

    Raises:
        GridError: heights are in feet, or lie beyond any sea, so that they are damaged or not in metres.
    """
    if (dataset.units[0] or "").strip().lower() in _FEET:
        raise GridError(f"{path}: its depths are in {dataset.units[0]}; convert them to metres")
    band = dataset.read(1, window=window, masked=True)
    if np.iscomplexobj(band):
        raise GridError(f"{path}: its cells hold {band.dtype}, must hold real numbers")
    with np.errstate(all="ignore"):  # damaged cells may be any number
        z = band.astype(np.float64).filled(np.nan)
    scale, offset = dataset.scales[0], dataset.offsets[0]
    if (scale, offset) != (1.0, 0.0):
        z = z * scale + offset
    if wrong := int(np.sum(np.abs(z) > _DEEPEST_M)):
        raise GridError(
            f"{path}: {wrong} of its cells are beyond 12 km, such as {z[np.abs(z) > _DEEPEST_M][0]:.6g}: they are"
            " damaged, not in metres, or mark what has no depth; set that value as nodata"
        )
    return np.asarray(z)


def level_crs(dataset: Any) -> Any:
    """Return the CRS of a grid's x and y, of pyproj; None where it has none."""
    from pyproj import CRS

    if dataset.crs is None:
        return None
    stored = CRS.from_wkt(dataset.crs.to_wkt())
    crs = stored.source_crs if stored.is_bound and stored.source_crs else stored
    return crs.sub_crs_list[0] if crs.is_compound else crs


def sense(dataset: Any, below: int, valid: int) -> tuple[bool, str]:
    """Return whether a grid's numbers are depths, positive down, and the reason in words.

    A BAG has heights. Another grid without a vertical CRS has depths if hardly any of its `valid` numbers are `below`
    zero; land and sea together are heights, whatever the share of land.
    """
    from pyproj import CRS

    crs = CRS.from_wkt(dataset.crs.to_wkt()) if dataset.crs is not None else None
    axis = next((a for a in crs.axis_info if a.direction.lower() in ("up", "down")), None) if crs else None
    name = crs.sub_crs_list[1].name if crs and crs.is_compound else axis.name if axis else ""
    if dataset.driver == "BAG":
        return False, f"{name or 'height'}, as in every BAG"
    if axis is not None:
        return axis.direction.lower() == "down", name
    share = below / max(valid, 1)
    quantity = "depth" if share < _DRYING else "height"
    reason = f"because {100 * share:.3g} % of its numbers are below zero"
    return quantity == "depth", f"taken as {quantity}, {reason}; its datum is not stated"


def crs_name(dataset: Any) -> str:
    """Return the CRS of a grid's x and y as EPSG:n where it has a code, else as WKT; empty where it has none."""
    crs = level_crs(dataset)
    code = crs.to_epsg() if crs else None
    return f"EPSG:{code}" if code else dataset.crs.to_wkt() if crs else ""


def is_variable(dataset: Any) -> bool:
    """Return whether the cells of a BAG hold grids of their own."""
    return dataset.tags().get("HAS_SUPERGRIDS", "FALSE").upper() == "TRUE"


def describe(path: Path) -> Description:
    """Return the description of a grid; only a stripe of it is in memory at a time.

    Raises:
        GridError: the file is neither GeoTIFF nor BAG, or is damaged.
    """
    from rasterio.windows import Window

    with opened(path) as dataset:
        valid, below, lowest, highest = 0, 0, np.inf, -np.inf
        step = max(dataset.block_shapes[0][0], _STRIPE // dataset.width, 1)
        for row in range(0, dataset.height, step):
            z = heights(path, dataset, Window(0, row, dataset.width, min(step, dataset.height - row)))
            z = z[np.isfinite(z)]
            valid += len(z)
            below += int(np.sum(z < 0))
            lowest, highest = min(lowest, z.min(initial=np.inf)), max(highest, z.max(initial=-np.inf))
        down, vertical = sense(dataset, below, valid)
        shallow, deep = (np.nan, np.nan) if not valid else (lowest, highest) if down else (-highest, -lowest)
        return Description(
            format="BAG" if dataset.driver == "BAG" else "GeoTIFF",
            rows=dataset.height,
            columns=dataset.width,
            cell_m=(abs(dataset.transform.a), abs(dataset.transform.e)),
            crs=crs_name(dataset),
            valid=valid,
            depth_min_m=float(shallow),
            depth_max_m=float(deep),
            down=down,
            vertical=vertical,
            variable=is_variable(dataset),
        )
