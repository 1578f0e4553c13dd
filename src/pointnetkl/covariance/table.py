"""The covariance table: whoever made a covariance, it stands in this form."""

from collections.abc import Iterable

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.covariance import gaussian

SCHEMA = pa.schema(
    [
        ("survey", pa.string()),
        ("submap", pa.int32()),
        ("method", pa.string()),
        ("q_xx_m2", pa.float64()),
        ("q_xy_m2", pa.float64()),
        ("q_yy_m2", pa.float64()),
    ]
)


def from_matrices(survey: str, method: str, submaps: Iterable[int], q: np.ndarray) -> pd.DataFrame:
    """Return a table of covariances (n, 2, 2) in m^2, each in its submap's frame, every one checked."""
    numbers = list(submaps)
    for number, matrix in zip(numbers, q, strict=True):
        gaussian.check(matrix, f"{survey}, submap {number}, {method}")
    return pd.DataFrame(
        {
            "survey": survey,
            "submap": np.array(numbers, np.int32),
            "method": method,
            "q_xx_m2": q[:, 0, 0],
            "q_xy_m2": q[:, 0, 1],
            "q_yy_m2": q[:, 1, 1],
        }
    )


def to_matrices(table: pd.DataFrame) -> np.ndarray:
    """Return the covariances (n, 2, 2) of a table's rows, in their order."""
    xx, xy, yy = (table[name].to_numpy() for name in ("q_xx_m2", "q_xy_m2", "q_yy_m2"))
    return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
