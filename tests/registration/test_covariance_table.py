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
    made = table.from_matrices("small", "constant", [4, 9], Q)
    artifacts.write_table(tmp_path / "q.parquet", made, table.SCHEMA, {})
    found = artifacts.read_table(tmp_path / "q.parquet", table.SCHEMA)
    assert found["submap"].tolist() == [4, 9]
    assert set(found["survey"]) == {"small"}
    assert np.array_equal(table.to_matrices(found), Q)


def test_matrices_with_yaw_come_back_from_a_file_that_is_read_by_whoever_takes_both(tmp_path: Path):
    factor = np.array([[2.0, 0.0, 0.0], [0.5, 1.0, 0.0], [1e-3, -2e-3, 3e-3]])
    q = np.stack([factor @ factor.T, np.diag([1.0, 4.0, 1e-6])])
    for given, dimensions in ((Q, 2), (q, 3)):
        made = table.from_matrices("small", "constant", [4, 9], given)
        artifacts.write_table(tmp_path / "q.parquet", made, table.schema(dimensions), {})
        found = artifacts.read_table(tmp_path / "q.parquet", table.SCHEMA, also=table.YAW)
        assert found.columns.tolist() == table.schema(dimensions).names
        assert np.array_equal(table.to_matrices(found), given)


def test_a_table_with_some_columns_of_yaw_must_have_all(tmp_path: Path):
    made = table.from_matrices("small", "constant", [4, 9], Q).assign(q_ww_rad2=1.0)
    some = pa.schema([*table.SCHEMA, table.YAW.field("q_ww_rad2")])
    artifacts.write_table(tmp_path / "q.parquet", made, some, {})
    with pytest.raises(artifacts.ArtifactError, match="lacks the column q_xw_m_rad"):
        artifacts.read_table(tmp_path / "q.parquet", table.SCHEMA, also=table.YAW)


def test_what_is_no_covariance_gets_into_no_table():
    with pytest.raises(CovarianceError, match="small, submap 9, constant: smallest eigenvalue"):
        table.from_matrices("small", "constant", [4, 9], Q * np.array([1, -1])[:, None, None])


def test_a_matrix_for_each_submap_is_demanded():
    with pytest.raises(ValueError, match="shorter"):
        table.from_matrices("small", "constant", [4, 9], Q[:1])


def test_files_of_one_survey_are_joined_and_one_of_another_is_refused(tmp_path: Path):
    paths = [tmp_path / f"{name}.parquet" for name in "abc"]
    for path, survey, method in zip(paths, ("small", "small", "other"), ("one", "two", "three"), strict=True):
        artifacts.write_table(path, table.from_matrices(survey, method, [4, 9], Q), table.SCHEMA, {})
    assert table.read(paths[:2], "small")["method"].tolist() == ["one", "one", "two", "two"]
    with pytest.raises(CovarianceError, match=r"c\.parquet: has covariances of survey other, not of small"):
        table.read(paths, "small")
