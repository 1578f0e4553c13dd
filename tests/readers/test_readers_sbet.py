"""SBET: post-processed navigation replaces a survey's own, at the right second of the right week."""

import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pointnetkl.readers import sbet
from pointnetkl.readers.formats.recording import PING_COLUMNS
from sbet_files import records, write

WEDNESDAY_S = datetime.datetime(2016, 3, 23, 18, 55, 40, tzinfo=datetime.UTC).timestamp()  # 17 leap seconds then
OF_WEEK_S = 3 * 86400 + 18 * 3600 + 55 * 60 + 40 + 17  # the same in GPS time since Sunday


def pings(time: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame(1.0, index=range(len(time)), columns=list(PING_COLUMNS)).assign(time_s=time, depth_m=7.0)


def test_pings_take_place_and_attitude_from_the_navigation_and_keep_their_depth(tmp_path: Path):
    navigation = sbet.read(write(tmp_path / "a.sbet", records(OF_WEEK_S + np.arange(1000) / 100)), WEDNESDAY_S)
    np.testing.assert_allclose(navigation.time_s - WEDNESDAY_S, np.arange(500) / 50, atol=1e-6)
    placed, without = sbet.apply(pings(WEDNESDAY_S + np.array([2.5, 5.005, 7.5])), navigation)
    assert without == 0
    np.testing.assert_allclose(placed["east"], [179.9975, -179.999995 + 1e-5, -179.9975], atol=1e-9)
    np.testing.assert_allclose(placed["north"], [-19.9975, -19.994995, -19.9925], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(placed["heading_rad"]), [355, 0.01, 5], atol=1e-6)
    np.testing.assert_allclose(placed["roll_rad"], [0.0025, 0.005005, 0.0075])
    np.testing.assert_allclose(placed["pitch_rad"], [-0.005, -0.01001, -0.015])
    assert placed["depth_m"].eq(7).all()


def test_pings_outside_the_navigation_and_in_its_gaps_are_left_out_and_counted(tmp_path: Path):
    time = np.concatenate([np.arange(500), np.arange(900, 1400)]) / 100
    navigation = sbet.read(write(tmp_path / "a.sbet", records(OF_WEEK_S + time)), WEDNESDAY_S)
    placed, without = sbet.apply(pings(WEDNESDAY_S + np.array([-60, 1, 7, 10, 3600])), navigation)
    assert (list(placed.index), without) == ([1, 3], 3)


@pytest.mark.parametrize("again", [True, False])
@pytest.mark.parametrize("survey", ["before", "behind"])
def test_over_a_week_s_end_times_go_on_or_begin_again(tmp_path: Path, again: bool, survey: str):
    sunday = datetime.datetime(2019, 6, 2, tzinfo=datetime.UTC).timestamp() - 18  # the week's end in UTC
    time = 604_800 + np.arange(-3000, 3000) / 100
    path = write(tmp_path / "a.sbet", records(np.mod(time, 604_800) if again else time))
    navigation = sbet.read(path, sunday + (-20 if survey == "before" else 20))
    np.testing.assert_allclose(navigation.time_s - sunday, np.arange(-1500, 1500) / 50, atol=1e-6)
    assert sbet.begins(path.read_bytes()[:4096])


def test_a_file_has_the_second_of_the_week_and_not_the_week(tmp_path: Path):
    time = 604_800 + np.arange(-200, 200) / 50
    navigation = sbet.read_week(write(tmp_path / "a.sbet", records(np.mod(time, 604_800))))
    np.testing.assert_allclose(navigation.time_s, time)
    navigation = sbet.read_week(write(tmp_path / "a.sbet", records(604_800 + np.arange(100) / 50)))
    np.testing.assert_allclose(navigation.time_s, np.arange(100) / 50, atol=1e-9)


def test_seconds_of_the_week_may_be_utc_s(tmp_path: Path):
    path = write(tmp_path / "a.sbet", records(OF_WEEK_S + np.arange(100) / 100))
    assert sbet.read(path, WEDNESDAY_S, sbet.UTC).time_s[0] == pytest.approx(WEDNESDAY_S + 17)
    with pytest.raises(ValueError, match="clock is 'local'"):
        sbet.read(path, WEDNESDAY_S, "local")


@pytest.mark.parametrize(("year", "month", "leap"), [(1999, 1, 13), (2008, 12, 14), (2012, 7, 16), (2026, 1, 18)])
def test_gps_time_is_ahead_of_utc_by_the_leap_seconds_of_its_day(tmp_path: Path, year: int, month: int, leap: int):
    day = datetime.datetime(year, month, 5, 12, tzinfo=datetime.UTC)
    of_week = (day.weekday() + 1) % 7 * 86400 + 43_200
    path = write(tmp_path / "a.sbet", records(of_week + np.arange(100) / 100))
    assert sbet.read(path, day.timestamp()).time_s[0] == pytest.approx(day.timestamp() - leap)


def test_a_survey_from_before_the_table_of_leap_seconds_is_refused(tmp_path: Path):
    path = write(tmp_path / "a.sbet", records(np.arange(100) / 100))
    with pytest.raises(sbet.SbetError, match="1997-07-14"):
        sbet.read(path, datetime.datetime(1997, 7, 14, tzinfo=datetime.UTC).timestamp())


def test_a_file_is_recognised_by_records_of_a_vehicle_that_moves_on():
    table = records(OF_WEEK_S + np.arange(30) / 200)
    assert sbet.begins(table.tobytes()[:4096])
    assert not sbet.begins(table[::-1].tobytes())
    assert not sbet.begins(bytes(4096))
    assert not sbet.begins(b"")
    assert not sbet.begins(np.arange(512).tobytes())  # whole numbers are as doubles next to zero
    assert not sbet.begins(table.astype(">f8").tobytes())
    assert not sbet.begins(b"ncols 100\nnrows 100\n" * 200)
    for column, wrong in ((0, 1e7), (1, 1.6), (2, 3.2), (5, 1e9), (7, 2.0), (12, np.nan)):
        damaged = table.copy()
        damaged[3, column] = wrong
        assert not sbet.begins(damaged.tobytes()), column


def test_damaged_records_are_left_out_and_a_cut_one_is_reported(tmp_path: Path):
    table = records(OF_WEEK_S + np.arange(1000) / 100)
    table[10, 1], table[20, 0], table[30, 0], table[40, 7] = np.nan, 5.0, 1e300, 9.0
    path = write(tmp_path / "a.sbet", table)
    path.write_bytes(path.read_bytes() + bytes(50))
    navigation = sbet.read(path, WEDNESDAY_S)
    assert navigation.skipped == 4
    assert navigation.problems == ["a.sbet: 50 bytes from byte 136000 on are cut off"]
    assert np.diff(navigation.time_s).max() < 0.06


def test_mutated_files_end_in_a_sentence_or_in_finite_navigation(tmp_path: Path):
    rng, path = np.random.default_rng(0), tmp_path / "mutated.sbet"
    content = records(OF_WEEK_S + np.arange(50) / 100).tobytes()
    for _ in range(500):
        changed = bytearray(content)
        for offset in rng.integers(0, len(changed), rng.integers(1, 40)):
            changed[offset] = rng.integers(0, 256)
        del changed[int(rng.integers(0, 2 * len(changed))) :]
        path.write_bytes(changed)
        sbet.begins(bytes(changed[:4096]))
        try:
            navigation = sbet.read(path, WEDNESDAY_S)
        except sbet.SbetError:
            continue
        assert np.isfinite([navigation.time_s, navigation.east, navigation.north, navigation.heading_rad]).all()
        assert navigation.skipped <= len(changed) // 136 - len(navigation.time_s)


def test_records_are_thinned_evenly_across_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sbet, "_BATCH", 37)
    navigation = sbet.read(write(tmp_path / "a.sbet", records(OF_WEEK_S + np.arange(1000) / 200)), WEDNESDAY_S)
    np.testing.assert_allclose(navigation.time_s - WEDNESDAY_S, np.arange(250) / 50, atol=1e-6)
    slow = sbet.read(write(tmp_path / "b.sbet", records(OF_WEEK_S + np.arange(100) / 10)), WEDNESDAY_S)
    assert (len(slow.time_s), slow.skipped) == (100, 0)


def test_what_has_no_record_of_a_vehicle_is_refused(tmp_path: Path):
    (tmp_path / "a.sbet").write_bytes(b"\xff" * 1360)
    with pytest.raises(sbet.SbetError, match="none of 10 records from byte 0 on"):
        sbet.read(tmp_path / "a.sbet", WEDNESDAY_S)
    with pytest.raises(sbet.SbetError, match="cannot be read"):
        sbet.read(tmp_path / "missing.sbet", WEDNESDAY_S)
