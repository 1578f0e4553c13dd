"""Poses from the columns of a table."""

import numpy as np
import pandas as pd

from pointnetkl.surveys import pose


def poses(table: pd.DataFrame) -> np.ndarray:
    """Return T_map_submap (n, 4, 4) of a table with columns x_m, y_m, z_m and yaw_rad, in the order of its rows."""
    rows = table[["x_m", "y_m", "z_m", "yaw_rad"]].to_numpy(np.float64)
    return np.array([pose.matrix(row[:3], row[3]) for row in rows]).reshape(-1, 4, 4)
