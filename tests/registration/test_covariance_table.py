"""A covariance table holds the covariances that were put in, and no other."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from pointnetkl.registration.covariance import table
from pointnetkl.registration.covariance.gaussian import CovarianceError
from pointnetkl.workflow import artifacts

Q = np.array([[[2.0, 0.5], [0.5, 1.0]], [[0.1, -0.01], [-0.01, 0.3]]])


def test_matrices_come_back_from_the_file(tmp_path: Path):
    rows = table.from_matrices("small", "constant", [4, 9], Q)
    artifacts.write_table(tmp_path / "q.parquet", rows, table.SCHEMA, {})
    read = artifacts.read_table(tmp_path / "q.parquet", table.SCHEMA)
    assert read["submap"].tolist() == [4, 9]
    assert set(read["survey"]) == {"small"}
    assert np.array_equal(table.to_matrices(read), Q)


def test_matrices_with_yaw_come_back_from_a_file_that_may_have_either(tmp_path: Path):
    factor = np.array([[2.0, 0.0, 0.0], [0.5, 1.0, 0.0], [1e-3, -2e-3, 3e-3]])
    q = np.stack([factor @ factor.T, np.diag([1.0, 4.0, 1e-6])])
    for matrices, dimensions in ((Q, 2), (q, 3)):
        rows = table.from_matrices("small", "constant", [4, 9], matrices)
        artifacts.write_table(tmp_path / "q.parquet", rows, table.schema(dimensions), {})
        read = artifacts.read_table(tmp_path / "q.parquet", table.SCHEMA, also=table.YAW)
        assert read.columns.tolist() == table.schema(dimensions).names
        assert np.array_equal(table.to_matrices(read), matrices)


def test_a_table_with_some_columns_of_yaw_must_have_all(tmp_path: Path):
    rows = table.from_matrices("small", "constant", [4, 9], Q).assign(q_ww_rad2=1.0)
    incomplete = pa.schema([*table.SCHEMA, table.YAW.field("q_ww_rad2")])
    artifacts.write_table(tmp_path / "q.parquet", rows, incomplete, {})
    with pytest.raises(artifacts.ArtifactError, match="lacks the column q_xw_m_rad"):
        artifacts.read_table(tmp_path / "q.parquet", table.SCHEMA, also=table.YAW)


def test_a_matrix_that_is_not_positive_definite_is_refused():
    with pytest.raises(CovarianceError, match="small, submap 9, constant: smallest eigenvalue"):
        table.from_matrices("small", "constant", [4, 9], Q * np.array([1, -1])[:, None, None])


def test_every_submap_needs_a_matrix():
    with pytest.raises(ValueError, match="shorter"):
        table.from_matrices("small", "constant", [4, 9], Q[:1])


def test_files_of_one_survey_are_joined_and_one_of_another_is_refused(tmp_path: Path):
    paths = [tmp_path / f"{name}.parquet" for name in "abc"]
    for path, survey, method in zip(paths, ("small", "small", "other"), ("one", "two", "three"), strict=True):
        artifacts.write_table(path, table.from_matrices(survey, method, [4, 9], Q), table.SCHEMA, {})
    assert table.read(paths[:2], "small")["method"].tolist() == ["one", "one", "two", "two"]
    with pytest.raises(CovarianceError, match=r"c\.parquet: has covariances of survey other, not of small"):
        table.read(paths, "small")
