"""Navigation beside raw files replaces theirs, and pings that it does not cover are reported."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import all_files
from generic_files import geographic, parquet
from pointnetkl.readers.formats import interpolation
from pointnetkl.workflow.errors import PointNetKLError
from sbet_files import records, write
from whole_survey import SETTINGS, Whole, read

WEEK_S, EPOCH_S, LEAP_S = 604_800.0, 315_964_800.0, 18.0


def sbet(folder: Path, begin: float, seconds: float, clock_s: float = LEAP_S, name: str = "post.sbet") -> Path:
    """Write navigation from `begin` (UTC) on."""
    time = np.arange(begin, begin + seconds, 0.05)
    table = records((time + clock_s - EPOCH_S) % WEEK_S)
    table[:, 1], table[:, 2] = np.deg2rad(10.001), np.deg2rad(5.0 + 2e-5 * (time - begin))
    table[:, 9], table[:, 10] = np.deg2rad(80.0), 0.0
    return write(folder / name, table)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """A folder with twelve seconds of a ship's pings."""
    (tmp_path / "line.all").write_bytes(all_files.survey())
    return tmp_path


def test_navigation_in_the_folder_replaces_the_ship_s_own(survey: Path):
    own = read(survey)
    sbet(survey, all_files.BEGIN - 1, 15)
    better = read(survey)
    assert len(better.pings) == len(own.pings) == 12
    assert better.pings["yaw_rad"].median() == pytest.approx(np.deg2rad(10.0), abs=0.02)
    assert better.pings["z_m"].tolist() == own.pings["z_m"].tolist()
    north = better.pings["y_m"] + better.origin[1] - own.pings["y_m"] - own.origin[1]
    assert north.median() == pytest.approx(110.6, abs=1.0)
    assert read_speed(better) == pytest.approx(2 * read_speed(own), rel=1e-2)


def read_speed(survey: Whole) -> float:
    return float(np.median(np.diff(survey.pings["x_m"])))


def test_the_clock_may_be_utc(survey: Path):
    sbet(survey, all_files.BEGIN - 1, 15, clock_s=0.0)
    with pytest.raises(PointNetKLError, match="gps right"):
        read(survey)
    assert len(read(survey, replace(SETTINGS, sbet_clock="utc")).pings) == 12


def test_pings_that_it_does_not_reach_are_counted(survey: Path):
    sbet(survey, all_files.BEGIN - 1, 6.5)
    result = read(survey)
    assert len(result.pings) == 7  # a second beyond its end is still near
    assert result.report["skipped"]["pings without a position on the earth"] == 5
    assert "line.all: 5 pings are at no time of" in " ".join(result.report["problems"])


def test_a_clock_that_is_none_is_refused():
    with pytest.raises(ValueError, match="sbet_clock is 'tai', must be gps or utc"):
        replace(SETTINGS, sbet_clock="tai")


def later(folder: Path, name: str, seconds: float) -> Path:
    """Write a line of four pings, 5 s apart, that begins so much after the ship's."""
    table = geographic(10.001, 5.0)
    return parquet(folder / name, table.assign(time_s=all_files.BEGIN + seconds + table["time_s"] - 1.5e9), crs=None)


def test_navigation_is_recognised_by_its_content_and_a_log_is_none(survey: Path):
    sbet(survey, all_files.BEGIN - 1, 15, name="post.out")
    better = read(survey)
    (survey / "log.out").write_text("started at 10:03\nwaves 2 m\n")
    (survey / "post.out").rename(survey / "post.nav")
    result = read(survey)
    pd.testing.assert_frame_equal(result.pings, better.pings)
    assert result.report["problems"][0] == "passed over: 1 file of no known format, log.out"


def test_damaged_navigation_is_reported_by_its_extension(survey: Path):
    (survey / "post.sbet").write_bytes(b"\xff" * 1360)
    with pytest.raises(PointNetKLError, match=r"post.sbet: none of 10 records"):
        read(survey)


def test_navigation_alone_is_no_survey(tmp_path: Path):
    path = sbet(tmp_path, all_files.BEGIN, 15)
    for path_or_folder in (path, tmp_path):
        with pytest.raises(PointNetKLError, match=r"post.sbet: is navigation, and no raw files"):
            read(path_or_folder)


def test_a_survey_of_more_than_a_week_is_refused_because_the_navigation_does_not_say_which(survey: Path):
    later(survey, "next.parquet", WEEK_S)
    for number, week in enumerate((0.0, WEEK_S)):
        sbet(survey, all_files.BEGIN - 1 + week, 20, name=f"{number}.sbet")
    with pytest.raises(PointNetKLError, match=r"0.sbet, .*1.sbet: .* spread over 7.0 days"):
        read(survey)


def test_most_pings_at_its_end_do_not_put_the_first_days_of_a_survey_into_another_week(tmp_path: Path):
    for day, name in ((0, "a"), (6, "b"), (6.1, "c"), (6.2, "d")):
        later(tmp_path, f"{name}.parquet", day * 86_400)
        sbet(tmp_path, all_files.BEGIN + day * 86_400 - 1, 20, name=f"{name}.sbet")
    assert len(read(tmp_path).pings) == 16


def test_two_files_of_navigation_that_disagree_are_refused_and_a_copy_does_no_harm(survey: Path):
    path = sbet(survey, all_files.BEGIN - 1, 15)
    better = read(survey)
    shutil.copy(path, survey / "copy.sbet")
    pd.testing.assert_frame_equal(read(survey).pings, better.pings)
    table = np.frombuffer(path.read_bytes(), "<f8").reshape(-1, 17).copy()
    table[:, 1] += 20 / 6.4e6
    write(survey / "copy.sbet", table)
    with pytest.raises(PointNetKLError, match=r"post.sbet: is 20 m away from .*copy.sbet at the same times"):
        read(survey)


def test_each_ping_takes_the_file_that_reaches_it(survey: Path):
    sbet(survey, all_files.BEGIN - 1, 15)
    result = read(survey)
    table = np.fromfile(survey / "post.sbet", "<f8").reshape(-1, 17)
    write(survey / "post.sbet", table[:140])
    write(survey / "post_2.sbet", table[140:])
    pd.testing.assert_frame_equal(read(survey).pings, result.pings, atol=0.2)


def test_of_long_navigation_only_what_lies_around_a_file_is_searched(survey: Path, monkeypatch: pytest.MonkeyPatch):
    sbet(survey, all_files.BEGIN - 3600, 7200)
    searched = []
    linear = interpolation.linear

    def counting(time: np.ndarray, sampled: np.ndarray, *arguments: object) -> np.ndarray:
        searched.append(len(sampled))
        return linear(time, sampled, *arguments)

    before = len(read(survey).pings)
    monkeypatch.setattr(interpolation, "linear", counting)
    assert len(read(survey).pings) == before == 12
    assert max(searched) < 400  # of 144,000
