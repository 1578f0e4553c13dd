"""Small grids of depths, as GeoTIFF and BAG."""

from pathlib import Path

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.transform import from_origin

RAMP = -50 - np.arange(60)[:, None] / 10 - np.arange(80) / 100


def geotiff(path: Path, z: np.ndarray = RAMP, **profile_changes: object) -> Path:
    """Write heights of cells of 2 m, the north-west corner at (1000, 2000)."""
    profile = {"crs": "EPSG:32632", "transform": from_origin(1000, 2000, 2, 2), "nodata": -9999.0, "dtype": "float32"}
    profile |= {"height": z.shape[0], "width": z.shape[1], "count": 1} | profile_changes
    with rasterio.open(path, "w", driver="GTiff", **profile) as dataset:
        dataset.write(z.astype(profile["dtype"]), 1)
    return path


def bag(path: Path, **profile_changes: object) -> Path:
    """Write the ramp as a BAG."""
    rasterio.shutil.copy(geotiff(path.with_suffix(".tif"), nodata=1e6, **profile_changes), path, driver="BAG")
    return path
