"""The soundings as a table: where each lies in the projected CRS, and when it was made."""

import numpy as np
import pandas as pd
import pyarrow as pa

SOUNDINGS = pa.schema(
    [
        ("ping", pa.int32()),  # as in track.csv, which names its file; -1 without pings
        ("beam", pa.int32()),
        ("time_s", pa.float64()),  # UTC since 1970; empty where it is not known
        ("x_m", pa.float64()),  # easting
        ("y_m", pa.float64()),  # northing
        ("z_m", pa.float64()),  # up
        ("quality", pa.int8()),  # 0: good
    ]
)


def rows(part: pd.DataFrame, time_s: np.ndarray, east_north: np.ndarray) -> pd.DataFrame:
    """Return soundings (survey.SOUNDINGS) with their times (n,) at eastings and northings (n, 2) as SOUNDINGS."""
    return part.assign(time_s=time_s, x_m=east_north[:, 0], y_m=east_north[:, 1])
