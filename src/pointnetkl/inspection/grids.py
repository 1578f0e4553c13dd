"""A grid of depths, GeoTIFF or BAG, as surveys are simulated over."""

import math
from pathlib import Path

import numpy as np

from pointnetkl.inspection import earth
from pointnetkl.inspection.cells import Cells
from pointnetkl.inspection.facts import Facts
from pointnetkl.inspection.found import Drawing, Found
from pointnetkl.simulation import depth_grid

_DRAWN = 900  # cells along the longer side
_VARIABLE = "a BAG of variable resolution: only its coarse cells are told, and no survey can be simulated over it"


def look(path: Path) -> Found:
    """Return what a grid holds; its cells are its soundings.

    Raises:
        GridError: the file is neither GeoTIFF nor BAG, or is damaged.
    """
    held = depth_grid.describe(path)
    cells, extent = _cells(path, held)
    west, east, south, north = extent
    in_metres = earth.is_metric(held.crs)
    problems = [f"{path.name}: {_VARIABLE}"] if held.variable else []
    if not in_metres:
        problems.append(f"{path.name}: its CRS is not in metres; reproject it, for example to UTM, to simulate over it")
    facts = Facts(
        str(path),
        format=held.format,
        kind="grid",
        pings=0,
        pings_used=0,
        soundings=held.rows * held.columns,
        valid=held.valid,
        area_m2=held.valid * math.prod(held.cell_m) if in_metres else None,
        cell_m=held.cell_m[0] if in_metres else None,
        depth_min_m=held.depth_min_m if held.valid else None,
        depth_max_m=held.depth_max_m if held.valid else None,
        crs=held.crs or None,
        extent_m=(west, south, east, north) if in_metres else None,
        **earth.place(held.crs, west, south),
        vertical=held.vertical if held.valid else None,
        problems=problems,
    )
    return Found(facts, Drawing(cells=cells) if in_metres and held.valid else None)


def _cells(path: Path, held: depth_grid.Description) -> tuple[Cells, tuple[float, float, float, float]]:
    """Return every so many-th cell of a grid, and its extent: west, east, south, north."""
    from rasterio.windows import Window  # with GDAL, slow to import

    step = -(-max(held.rows, held.columns) // _DRAWN)
    with depth_grid.opened(path) as dataset:
        bounds, transform = dataset.bounds, dataset.transform
        taken = range(0, held.rows, step)
        rows = [depth_grid.heights(path, dataset, Window(0, row, held.columns, 1))[0, ::step] for row in taken]
    z = np.stack(rows)
    if transform.e < 0:
        z = z[::-1]
    depth = z if held.down else -z
    extent = (bounds.left, bounds.right, min(bounds.bottom, bounds.top), max(bounds.bottom, bounds.top))
    return Cells(depth, extent, held.cell_m[0] * step), extent
