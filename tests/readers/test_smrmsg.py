"""SMRMSG: what post-processed navigation says of its own errors, in metres and arc minutes."""

import re
from pathlib import Path

import numpy as np
import pytest

import raw_survey
from pointnetkl.readers import smrmsg
from pointnetkl.readers.smrmsg import SmrmsgError


def written(path: Path, table: np.ndarray) -> Path:
    path.write_bytes(table.astype("<f8").tobytes())
    return path


def records(path: Path) -> np.ndarray:
    return np.fromfile(path, "<f8").reshape(-1, 10).copy()


def test_position_is_that_of_an_axis_and_heading_is_in_arc_minutes(tmp_path: Path):
    accuracy = smrmsg.read(raw_survey.smrmsg(tmp_path / "smrmsg_1.out", 0.05, 6.0))
    assert accuracy.position_m == pytest.approx(0.05)
    assert accuracy.heading_rad == pytest.approx(np.deg2rad(0.1))


def test_north_and_east_count_the_same_and_down_does_not(tmp_path: Path):
    table = records(raw_survey.smrmsg(tmp_path / "a", 0.05, 6.0))
    table[:, 1], table[:, 2], table[:, 3] = 0.03, 0.04, 99.0
    assert smrmsg.read(written(tmp_path / "a", table)).position_m == pytest.approx(0.05 / np.sqrt(2))


def test_a_few_gross_records_do_not_move_the_median(tmp_path: Path):
    table = records(raw_survey.smrmsg(tmp_path / "a", 0.05, 6.0))
    table[:5, 1:3], table[5:9] = 9000.0, np.nan
    table[9, 0], table[10, 9] = -1.0, np.inf
    accuracy = smrmsg.read(written(tmp_path / "a", table))
    assert (accuracy.position_m, accuracy.heading_rad) == pytest.approx((0.05, np.deg2rad(0.1)))


@pytest.mark.parametrize("heading", [0.0, -1.0, np.nan, 1e9])
def test_a_heading_that_is_not_stated_is_nan(tmp_path: Path, heading: float):
    assert np.isnan(smrmsg.read(raw_survey.smrmsg(tmp_path / "a", 0.05, heading)).heading_rad)


def test_bytes_after_the_last_record_are_passed_over(tmp_path: Path):
    path = raw_survey.smrmsg(tmp_path / "a", 0.05, 6.0)
    path.write_bytes(path.read_bytes() + b"\x00" * 79)
    assert smrmsg.read(path).position_m == pytest.approx(0.05)


@pytest.mark.parametrize("content", [b"", b"\x00" * 79, b"\x00" * 800, b"\xff" * 800, b"latitude,longitude\n" * 50])
def test_what_is_no_smrmsg_is_refused_in_a_sentence(tmp_path: Path, content: bytes):
    (tmp_path / "smrmsg.out").write_bytes(content)
    with pytest.raises(SmrmsgError, match=re.escape(str(tmp_path / "smrmsg.out")) + ".*is it SMRMSG"):
        smrmsg.read(tmp_path / "smrmsg.out")


@pytest.mark.parametrize("name", ["gone", "folder"])
def test_what_cannot_be_read_is_refused_in_a_sentence(tmp_path: Path, name: str):
    (tmp_path / "folder").mkdir()
    with pytest.raises(SmrmsgError, match=f"{name}: cannot be read|{name}: .*is it SMRMSG"):
        smrmsg.read(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "known"),
    [("smrmsg_Mission 1.out", True), ("X_SMRMSG.OUT", True), ("sbet_Mission 1.out", False), ("line.all", False)],
)
def test_a_file_is_known_by_its_name(name: str, known: bool):
    assert smrmsg.is_accuracy(Path("somewhere") / name) is known
