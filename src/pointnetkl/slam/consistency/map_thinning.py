"""What thinning does to the map-to-map error: it is not the same measure of fewer points.

Fewer points that ask overlook submaps that barely reach into a cell, whose pairs have the largest errors there, but
tell the worst pair of a cell less surely, which makes it worse. Fewer points that answer are farther from every
other, so that a map looks worse than it is.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.slam.consistency.map_to_map import MapToMap

THINNINGS = (1, 2, 4, 8)
SCHEMA = pa.schema(
    [
        ("survey", pa.string()),
        ("thinning", pa.int32()),  # every so many-th point
        ("cells", pa.int64()),  # that two or more submaps share
        ("map_to_map_m", pa.float64()),  # thinned points ask, all points answer: the benchmark's measure
        ("both_thinned_m", pa.float64()),  # thinned points ask and answer
    ]
)


def table(survey: str, clouds: Sequence[np.ndarray], poses: np.ndarray, cell: float) -> pd.DataFrame:
    """Return the map-to-map error by thinning (SCHEMA), of clouds (n_i, 3) at poses (n, 4, 4); cells in metres."""
    return pd.DataFrame([_row(survey, clouds, poses, cell, thinning) for thinning in THINNINGS])


def _row(
    survey: str, clouds: Sequence[np.ndarray], poses: np.ndarray, cell: float, thinning: int
) -> dict[str, str | float]:
    asking = MapToMap(clouds, cell, thinning).cells(poses)
    both = MapToMap([cloud[::thinning] for cloud in clouds], cell, 1).cells(poses) if thinning > 1 else asking
    sizes = {"thinning": thinning, "cells": len(asking.row)}
    return {"survey": survey, **sizes, "map_to_map_m": asking.rms, "both_thinned_m": both.rms}
