"""Generic pings, as tables and as Parquet files."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq


def rows(pings: int = 4, beams: int = 5, heading: float = 0.0, **columns: Any) -> pd.DataFrame:
    """Return generic pings of a vehicle 20 m deep, 10 m apart along its heading from (500 000, 6 000 000)."""
    ping, beam = np.repeat(np.arange(pings), beams), np.tile(np.arange(beams), pings)
    table = pd.DataFrame({"time_s": 1.5e9 + 5.0 * ping, "depth_m": 20.0, "heading_rad": heading, "beam": beam})
    table = table.assign(x_m=5e5 + 10.0 * ping * np.sin(heading), y_m=6e6 + 10.0 * ping * np.cos(heading))
    table = table.assign(along_m=0.5, across_m=10.0 * (beam - beams // 2), down_m=30.0 + beam, roll_rad=0.01)
    return table.assign(pitch_rad=0.02, quality=0, **columns)


def geographic(longitude: float, latitude: float, **columns: Any) -> pd.DataFrame:
    """Return generic pings in longitude and latitude, all at one place."""
    return rows(**columns).drop(columns=["x_m", "y_m"]).assign(longitude_deg=longitude, latitude_deg=latitude)


def parquet(path: Path, table: pd.DataFrame, crs: str | None = "EPSG:32633") -> Path:
    """Write generic pings as Parquet."""
    content = pa.Table.from_pandas(table, preserve_index=False)
    pq.write_table(content.replace_schema_metadata({"crs": crs} if crs else {}), path)
    return path
