"""LAS and LAZ files, written by laspy."""

from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS


def write(
    path: Path, count: int = 300, kind: int = 6, crs: object = 32633, z: float = -50.0, **columns: object
) -> Path:
    """Write points about (500 000, 6 000 000) by laspy, compressed by the name's ending."""
    header = laspy.LasHeader(point_format=kind)
    header.scales, header.offsets = [0.01, 0.01, 0.001], [5e5, 6e6, 0]
    if crs is not None:
        header.add_crs(CRS.from_user_input(crs))
    points = laspy.LasData(header)
    rng = np.random.default_rng(count)
    points.x, points.y = 5e5 + rng.uniform(-200, 200, count), 6e6 + rng.uniform(-200, 200, count)
    points.z = z + rng.uniform(-2, 2, count)
    for column, values in columns.items():
        points[column] = values
    points.write(str(path), do_compress=path.suffix == ".laz")
    return path
