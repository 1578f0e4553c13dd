"""SBET and SMRMSG, unpacked by struct as PDAL documents them, and read back beside raw pings; MB-System's text."""

import datetime
import struct
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import corrected_survey
import whole_survey
from generic_files import parquet
from pointnetkl.correction.products import mbsystem, navigation_files
from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import Corrected
from pointnetkl.readers import sbet

GPS_EPOCH = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC).timestamp()
WEEK_S, LEAP_S = 604_800, 18  # GPS minus UTC in 2017


def written(path: Path, survey: Corrected) -> list[str]:
    return navigation_files.write(path / "navigation.sbet", path / "navigation.smrmsg", Placed(survey))


def unpacked(file: Path, doubles: int) -> np.ndarray:
    return np.array(list(struct.iter_unpack(f"<{doubles}d", file.read_bytes())))


def test_sbet_has_the_corrected_places_headings_and_speeds(tmp_path: Path):
    survey = corrected_survey.corrected(heads=2)
    assert written(tmp_path, survey) == []
    rows, track = unpacked(tmp_path / "navigation.sbet", 17), Placed(corrected_survey.corrected())
    assert track.earth is not None
    gps = (track.time_s - GPS_EPOCH + LEAP_S) % WEEK_S
    np.testing.assert_allclose(rows[:, 0], gps, atol=1e-6, rtol=0)
    np.testing.assert_allclose(np.rad2deg(rows[:, 1]), track.earth.latitude_deg, rtol=1e-14)
    np.testing.assert_allclose(np.rad2deg(rows[:, 2]), track.earth.longitude_deg, rtol=1e-14)
    np.testing.assert_array_equal(rows[:, 3], track.z_m)
    np.testing.assert_array_equal(rows[:, 7], track.column("roll_rad"))
    np.testing.assert_allclose(rows[:, 9], track.heading_rad, rtol=1e-14)
    assert not rows[:, 10].any()
    assert np.isnan(rows[:, 11:]).all()
    np.testing.assert_allclose(np.hypot(rows[:, 4], rows[:, 5]), corrected_survey.SPEED_M_S, atol=0.01)
    course = np.arctan2(rows[:, 5], rows[:, 4])  # east, north: with the heading, up to its noise
    np.testing.assert_allclose(np.cos(course - rows[:, 9]), 1.0, atol=2e-3)
    down = np.gradient(-track.z_m, track.time_s)
    np.testing.assert_allclose(rows[5:100, 6], down[5:100], atol=1e-6)


def test_smrmsg_has_what_is_known_of_accuracy(tmp_path: Path):
    survey = corrected_survey.corrected()
    written(tmp_path, survey)
    rows, track = unpacked(tmp_path / "navigation.smrmsg", 10), survey.track
    np.testing.assert_array_equal(rows[:, 0], unpacked(tmp_path / "navigation.sbet", 17)[:, 0])
    # the map's axes are 1.2 degrees off: a sum stays, up to the map's scale
    np.testing.assert_allclose(rows[:, 1] ** 2 + rows[:, 2] ** 2, track["var_xx_m2"] + track["var_yy_m2"], rtol=2e-3)
    np.testing.assert_allclose(rows[:, 1], np.sqrt(track["var_yy_m2"]), rtol=0.02)
    np.testing.assert_allclose(rows[:, 9], np.rad2deg(np.sqrt(1e-5)) * 60)
    assert np.isnan(rows[:, 3:9]).all()


def test_our_reader_gives_the_times_and_places_back(tmp_path: Path):
    survey = corrected_survey.corrected(heads=2)
    written(tmp_path, survey)
    back, track = (
        sbet.read(tmp_path / "navigation.sbet", corrected_survey.BEGIN_S),
        Placed(corrected_survey.corrected()),
    )
    assert track.earth is not None
    assert back.skipped == 0
    np.testing.assert_array_equal(back.time_s, track.time_s)
    np.testing.assert_allclose(back.north, track.earth.latitude_deg, rtol=1e-14)
    np.testing.assert_allclose(np.cos(back.heading_rad - track.heading_rad), 1.0)


def test_beside_raw_pings_it_puts_them_where_the_correction_did(tmp_path: Path):
    survey = corrected_survey.corrected()
    written(tmp_path, survey)
    parquet(tmp_path / "raw.parquet", _raw(survey), crs=None)
    read = whole_survey.read(tmp_path)
    assert read.crs == survey.crs
    after = corrected_survey.after(survey.track)
    place = read.pings[["x_m", "y_m"]].to_numpy() + read.origin
    np.testing.assert_allclose(place, after[:, :2] + survey.origin, atol=1e-4)
    np.testing.assert_allclose(np.cos(read.pings["yaw_rad"] - after[:, 2]), 1.0, atol=1e-9)
    np.testing.assert_allclose(read.pings["z_m"], survey.track["z_m"], atol=1e-9)


def _raw(survey: Corrected) -> pd.DataFrame:
    """Return generic raw pings in longitude and latitude, where navigation was 100 m off."""
    placed = Placed(survey)
    assert placed.earth is not None
    pings = pd.DataFrame({"time_s": placed.time_s, "longitude_deg": placed.earth.longitude_deg})
    pings = pings.assign(latitude_deg=placed.earth.latitude_deg + 0.001, depth_m=-placed.z_m, heading_rad=0.0)
    pings = pings.assign(roll_rad=0.0, pitch_rad=0.0, along_m=0.0, down_m=30.0, quality=0)
    return pings.merge(pd.DataFrame({"beam": range(3), "across_m": [-10.0, 0.0, 10.0]}), how="cross")


def test_a_survey_over_the_end_of_a_week_goes_on_above_it(tmp_path: Path):
    end = GPS_EPOCH + 2000 * WEEK_S - LEAP_S
    track = corrected_survey.corrected().track
    survey = corrected_survey.with_track(
        corrected_survey.corrected(), time_s=track["time_s"] - track["time_s"].iloc[100] + end
    )
    assert written(tmp_path, survey) == []
    time = unpacked(tmp_path / "navigation.sbet", 17)[:, 0]
    assert time[0] < WEEK_S <= time[100] < time[-1]
    assert (np.diff(time) > 0).all()
    np.testing.assert_allclose(sbet.read(tmp_path / "navigation.sbet", end).time_s, survey.track["time_s"], rtol=0)


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"roll_rad": np.nan}, "not all pings have roll and pitch"),
        ({"pitch_rad": np.nan}, "not all pings have roll and pitch"),
        ({"time_s": np.linspace(1.5e9, 1.5e9 + 8 * 86_400, 453)}, r"lasts 8\.0 days"),
        ({"time_s": 1.5e9}, "at one time only"),
        ({"time_s": np.arange(9e8, 9e8 + 453)}, "leap seconds are known from 1999"),
    ],
)
def test_without_all_that_it_needs_there_is_no_sbet(tmp_path: Path, columns: dict[str, object], reason: str):
    survey = corrected_survey.with_track(corrected_survey.corrected(), **columns)
    (sentence,) = written(tmp_path, survey)
    assert pd.Series([sentence]).str.contains(reason).all()
    assert list(tmp_path.iterdir()) == []


def test_a_local_survey_and_submaps_have_neither_sbet_nor_files_of_mb_system(tmp_path: Path):
    local, submaps = corrected_survey.corrected("local"), corrected_survey.of_submaps(corrected_survey.UTM)
    assert "no place on the earth" in written(tmp_path, local)[0]
    assert "no times" in written(tmp_path, submaps)[0]
    for survey in (local, submaps):
        (sentence,) = mbsystem.write(tmp_path / "na0", tmp_path / "n.fnv", Placed(survey))
        assert sentence.startswith("no files for MB-System")
    assert list(tmp_path.iterdir()) == []


def test_each_raw_file_has_a_na0_by_its_name(tmp_path: Path):
    survey = corrected_survey.corrected(heads=2)
    assert mbsystem.write(tmp_path / "na0", tmp_path / "n.fnv", Placed(survey)) == []
    assert {file.name for file in (tmp_path / "na0").iterdir()} == {"first.all.na0", "second.all.na0"}
    content = (tmp_path / "na0" / "first.all.na0").read_bytes()
    lines = content.decode().split("\r\n")
    assert "\n" not in "".join(lines)
    rows = np.array([line.split() for line in lines if line and line[0] != "#"], np.float64)
    _assert_navigation(rows, np.flatnonzero(Placed(corrected_survey.corrected()).files == "first.all"))
    assert rows.shape[1] == 6 + 10
    assert not rows[:, 14:].any()  # heave, and the offset of z


def test_one_fnv_has_the_whole_survey_between_tabs(tmp_path: Path):
    mbsystem.write(tmp_path / "na0", tmp_path / "n.fnv", Placed(corrected_survey.corrected(heads=2)))
    lines = (tmp_path / "n.fnv").read_text().splitlines()
    assert {len(line.split("\t")) for line in lines} == {10}
    _assert_navigation(np.array([line.split() for line in lines], np.float64), np.arange(453))


def _assert_navigation(rows: np.ndarray, pings: np.ndarray) -> None:
    track = Placed(corrected_survey.corrected())
    assert track.earth is not None
    assert len(rows) == len(pings)
    dates = [datetime.datetime(*map(int, row[:5]), tzinfo=datetime.UTC).timestamp() + row[5] for row in rows]
    np.testing.assert_allclose(dates, track.time_s[pings], atol=1e-5, rtol=0)
    np.testing.assert_allclose(rows[:, 6], track.time_s[pings], atol=1e-5, rtol=0)
    np.testing.assert_allclose(rows[:, 7], track.earth.longitude_deg[pings], atol=1e-9)
    np.testing.assert_allclose(rows[:, 8], track.earth.latitude_deg[pings], atol=1e-9)
    np.testing.assert_allclose(rows[:, 9], np.rad2deg(track.heading_rad[pings]), atol=0.006)
    np.testing.assert_allclose(rows[:, 10], 3.6 * corrected_survey.SPEED_M_S, atol=0.04)
    np.testing.assert_allclose(rows[:, 11], -track.z_m[pings], atol=6e-4)
    np.testing.assert_allclose(rows[:, 12], np.rad2deg(track.column("roll_rad")[pings]), atol=6e-3)


@pytest.mark.parametrize("name", ["../outside.all", "", "a/b.all", ".."])
def test_a_name_that_is_no_file_s_writes_nothing_elsewhere(tmp_path: Path, name: str):
    survey = corrected_survey.with_track(corrected_survey.corrected(), file=name)
    folder = tmp_path / "corrected"
    (sentence,) = mbsystem.write(folder / "na0", folder / "n.fnv", Placed(survey))
    assert "not the name of a file" in sentence
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["n.fnv"]


def test_attitude_that_is_not_recorded_is_nan_in_files_of_mb_system(tmp_path: Path):
    survey = corrected_survey.with_track(corrected_survey.corrected(), roll_rad=np.nan)
    mbsystem.write(tmp_path / "na0", tmp_path / "n.fnv", Placed(survey))
    rows = np.array([line.split() for line in (tmp_path / "n.fnv").read_text().splitlines()], np.float64)
    assert np.isnan(rows[:, 12]).all()
    assert np.isfinite(rows[:, 13]).all()
