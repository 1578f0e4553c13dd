"""A grid of depths, GeoTIFF or BAG, over which surveys can be simulated."""

import math
from pathlib import Path

import numpy as np

from pointnetkl.inspection import earth
from pointnetkl.inspection.cells import Cells
from pointnetkl.inspection.facts import Drawing, Facts, Inspection
from pointnetkl.simulation import depth_grid

_DRAWN = 900  # cells along the longer side
_VARIABLE = "a BAG of variable resolution: only its coarse cells are described, and no survey can be simulated over it"


def inspect(path: Path) -> Inspection:
    """Return the facts and the drawing of a grid; its cells count as soundings.

    Raises:
        GridError: the file is neither GeoTIFF nor BAG, or is damaged.
    """
    grid = depth_grid.describe(path)
    cells, extent = _cells(path, grid)
    west, east, south, north = extent
    in_metres = earth.is_metric(grid.crs)
    problems = [f"{path.name}: {_VARIABLE}"] if grid.variable else []
    if not in_metres:
        problems.append(f"{path.name}: its CRS is not in metres; reproject it, for example to UTM, to simulate over it")
    facts = Facts(
        str(path),
        format=grid.format,
        kind="grid",
        pings=0,
        pings_used=0,
        soundings=grid.rows * grid.columns,
        valid=grid.valid,
        area_m2=grid.valid * math.prod(grid.cell_m) if in_metres else None,
        cell_m=grid.cell_m[0] if in_metres else None,
        depth_min_m=grid.depth_min_m if grid.valid else None,
        depth_max_m=grid.depth_max_m if grid.valid else None,
        crs=grid.crs or None,
        extent_m=(west, south, east, north) if in_metres else None,
        **earth.place(grid.crs, west, south),
        vertical=grid.vertical if grid.valid else None,
        problems=problems,
    )
    return Inspection(facts, Drawing(cells=cells) if in_metres and grid.valid else None)


def _cells(path: Path, grid: depth_grid.Description) -> tuple[Cells, tuple[float, float, float, float]]:
    """Return every k-th cell of a grid, and its extent: west, east, south, north."""
    from rasterio.windows import Window  # with GDAL, slow to import

    step = -(-max(grid.rows, grid.columns) // _DRAWN)
    with depth_grid.opened(path) as dataset:
        bounds, transform = dataset.bounds, dataset.transform
        sampled = range(0, grid.rows, step)
        rows = [depth_grid.heights(path, dataset, Window(0, row, grid.columns, 1))[0, ::step] for row in sampled]
    z = np.stack(rows)
    if transform.e < 0:
        z = z[::-1]
    depth = z if grid.down else -z
    extent = (bounds.left, bounds.right, min(bounds.bottom, bounds.top), max(bounds.bottom, bounds.top))
    return Cells(depth, extent, grid.cell_m[0] * step), extent
