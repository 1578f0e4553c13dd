"""A covariance table holds the covariances that were put in, and no other."""

from pathlib import Path

import numpy as np
import pytest

from pointnetkl import artifacts
from pointnetkl.covariance import table
from pointnetkl.covariance.gaussian import CovarianceError

Q = np.array([[[2.0, 0.5], [0.5, 1.0]], [[0.1, -0.01], [-0.01, 0.3]]])


def test_matrices_come_back_from_the_file(tmp_path: Path):
    made = table.from_matrices("small", "constant", [4, 9], Q)
    artifacts.write_table(tmp_path / "q.parquet", made, table.SCHEMA, {})
    found = artifacts.read_table(tmp_path / "q.parquet", table.SCHEMA)
    assert found["submap"].tolist() == [4, 9]
    assert set(found["survey"]) == {"small"}
    assert np.array_equal(table.to_matrices(found), Q)


def test_what_is_no_covariance_gets_into_no_table():
    with pytest.raises(CovarianceError, match="small, submap 9, constant: smallest eigenvalue"):
        table.from_matrices("small", "constant", [4, 9], Q * np.array([1, -1])[:, None, None])


def test_a_matrix_for_each_submap_is_demanded():
    with pytest.raises(ValueError, match="shorter"):
        table.from_matrices("small", "constant", [4, 9], Q[:1])
