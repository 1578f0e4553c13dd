"""The covariance table, whose form is the same for every method.

Q is (M, M), of errors in x, y (M = 2) or in x, y and yaw (M = 3), which adds the columns of YAW.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.registration.covariance import gaussian
from pointnetkl.workflow import artifacts

_Q = (("q_xx_m2", 0, 0), ("q_xy_m2", 0, 1), ("q_yy_m2", 1, 1))
_Q_YAW = (("q_xw_m_rad", 0, 2), ("q_yw_m_rad", 1, 2), ("q_ww_rad2", 2, 2))
SCHEMA = pa.schema(
    [
        ("survey", pa.string()),
        ("submap", pa.int32()),
        ("method", pa.string()),
        *((name, pa.float64()) for name, _, _ in _Q),
    ]
)
YAW = pa.schema([(name, pa.float64()) for name, _, _ in _Q_YAW])  # w is yaw


def schema(dimensions: int) -> pa.Schema:
    """Return the table's schema for covariances of M dimensions, 2 or 3."""
    return SCHEMA if dimensions == 2 else pa.schema([*SCHEMA, *YAW])


def read(paths: Sequence[Path], survey: str | None = None) -> pd.DataFrame:
    """Return the rows of several covariance tables, which must be of `survey` if it is given.

    Raises:
        CovarianceError: a file has covariances of another survey.
        ArtifactError: a file is missing or damaged.
    """
    tables = [artifacts.read_table(path, SCHEMA, also=YAW) for path in paths]
    for path, rows in zip(paths, tables, strict=True):
        if survey is not None and (strangers := sorted(set(rows["survey"]) - {survey})):
            raise gaussian.CovarianceError(
                f"{path}: has covariances of survey {strangers[0]}, not of {survey}; give the files of one survey"
            )
    return pd.concat(tables, ignore_index=True)


def from_matrices(survey: str, method: str, submaps: Iterable[int], q: np.ndarray) -> pd.DataFrame:
    """Return a table of covariances (n, M, M) in m and rad, each in its submap's frame, after checking each one."""
    numbers = list(submaps)
    for number, matrix in zip(numbers, q, strict=True):
        gaussian.check(matrix, f"{survey}, submap {number}, {method}")
    return pd.DataFrame({"survey": survey, "submap": np.array(numbers, np.int32), "method": method, **to_columns(q)})


def to_columns(q: np.ndarray) -> dict[str, np.ndarray]:
    """Return the entries of covariances (..., M, M) by the names of their columns."""
    named = _Q if q.shape[-1] == 2 else (*_Q, *_Q_YAW)
    return {name: q[..., row, column][()] for name, row, column in named}  # [()]: a number, no array, for one matrix


def to_matrices(table: pd.DataFrame) -> np.ndarray:
    """Return the covariances (n, M, M) of a table's rows, in their order; M is 3 where it has the columns of YAW."""
    named = (*_Q, *_Q_YAW) if YAW.names[-1] in table else _Q
    m = max(column for _, _, column in named) + 1
    q = np.empty((len(table), m, m))
    for name, row, column in named:
        q[:, row, column] = q[:, column, row] = table[name].to_numpy()
    return q
