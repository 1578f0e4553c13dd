"""Table of what thinning does to the map-to-map error."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from pointnetkl.reporting.text_table import Block, block
from pointnetkl.workflow import artifacts

Numbers = Mapping[str, Any]
_ERRORS = [(name, pa.float64()) for name in ("map_to_map_m", "both_thinned_m")]
THINNING = pa.schema([("survey", pa.string()), ("thinning", pa.int32()), ("cells", pa.int64()), *_ERRORS])


def read(folder: Path, surveys: Iterable[str]) -> pd.DataFrame:
    """Read what stage slam found of each survey in its folder, one table of schema THINNING."""
    every = [artifacts.read_table(folder / f"{name}_map_thinning.parquet", THINNING) for name in surveys]
    return pd.concat(every, ignore_index=True)


def thinning(found: pd.DataFrame, datasets: Numbers) -> Block:
    """Return each survey's map-to-map error at its GT by thinning (THINNING), and against none."""
    rows = []
    for survey, of in found.groupby("survey", sort=False):
        whole = of.loc[of["thinning"] == 1, "map_to_map_m"].iloc[0]
        known = {"survey": survey, "simulated": datasets[survey]["simulated"]}
        rows += [{**known, **row, "ratio": row["map_to_map_m"] / whole} for row in of.to_dict("records")]
    caption = "Map-to-map error at GT, metres, by thinning of the points that ask, or of both sides; ratio: to 1."
    columns = ["survey", "simulated", "thinning", "cells", "map_to_map_m", "ratio", "both_thinned_m"]
    return block(caption, rows, columns)
