"""Outliers are flagged and rugged ground is not; duplicate pings and pings out of order are counted."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from generic_files import parquet, rows
from pointnetkl.readers import cleaning, formats
from pointnetkl.readers.formats import recording
from pointnetkl.readers.formats.recording import PING_COLUMNS, SOUNDING_COLUMNS, Recording
from pointnetkl.surveys.survey import SUBMAPS, SWATHS
from whole_survey import SETTINGS, Whole
from whole_survey import read as read_whole

HOW = cleaning.Settings(8.0, 0.05)
PINGS, BEAMS, DEPTH_M = 40, 101, 50.0


def swath() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ping, metres to starboard and down (PINGS * BEAMS,) of a slope of one in four, with a sonar's noise."""
    across = np.tile(np.linspace(-80, 80, BEAMS), PINGS)
    ping = np.repeat(np.arange(PINGS), BEAMS)
    down = DEPTH_M + 0.25 * across + 0.1 * ping + np.random.default_rng(0).normal(0, 0.1, len(ping))
    return ping, across, down


def flagged(ping: np.ndarray, across: np.ndarray, down: np.ndarray, settings: cleaning.Settings = HOW) -> list[int]:
    """Return the rows of the gross errors."""
    return np.flatnonzero(cleaning.outlying(ping, across, down, settings)).tolist()


def test_a_blunder_in_the_middle_of_a_swath_is_flagged_and_nothing_else():
    ping, across, down = swath()
    wrong = [5 * BEAMS + 50, 9 * BEAMS + 20, 9 * BEAMS + 21, 30 * BEAMS + 97, 39 * BEAMS + 1]
    down[wrong] += [8.0, -12.0, -11.0, 300.0, -40.0]
    assert flagged(ping, across, down) == wrong
    assert flagged(ping, across, down, cleaning.NONE) == []


def test_what_is_smaller_than_the_share_of_the_depth_is_left_to_those_who_cut_submaps():
    ping, across, down = swath()
    down[5 * BEAMS + 50] += 0.04 * DEPTH_M
    assert flagged(ping, across, down) == []
    assert flagged(ping, across, down, cleaning.Settings(8.0, 0.03)) == [5 * BEAMS + 50]


@pytest.mark.parametrize("foot", [lambda ping, across: across > 7.0, lambda ping, across: ping > 20])
def test_a_wall_loses_no_sounding(foot):
    ping, across, down = swath()
    assert flagged(ping, across, down - 20.0 * foot(ping, across)) == []


def test_a_rock_that_three_pings_hit_once_and_a_mast_that_one_ping_hits_thrice_are_kept():
    ping, across, down = swath()
    rock = [k * BEAMS + 40 for k in (10, 11, 12)]
    mast = [25 * BEAMS + k for k in (70, 71, 72)]
    down[rock] -= 6.0
    down[mast] -= [15.0, 20.0, 14.0]
    assert flagged(ping, across, down) == []


def test_company_counts_once_also_that_of_the_first_and_the_last_sounding():
    ping, across, down = swath()
    last = len(ping) - 1
    down[[0, 1, 5 * BEAMS, 5 * BEAMS + 1, last - 1, last]] -= 20.0
    assert flagged(ping, across, down) == [1, 5 * BEAMS + 1, last - 1]


def test_ground_as_rough_as_the_blunder_is_no_blunder():
    ping, across, down = swath()
    rough = down + np.random.default_rng(1).normal(0, 3.0, len(down))
    assert len(flagged(ping, across, rough)) < 1e-4 * len(down) + 1


def test_the_order_of_beams_does_not_matter_and_heads_that_ping_in_turn_are_judged_apart():
    ping, across, down = swath()
    wrong = [5 * BEAMS + 30, 20 * BEAMS + 70]
    down[wrong] += 9.0
    mixed = np.lexsort((np.random.default_rng(2).random(len(ping)), ping))
    assert sorted(mixed[flagged(ping[mixed], across[mixed], down[mixed])].tolist()) == wrong
    heads = 2 * ping + (across > 0)
    order = np.argsort(heads, kind="stable")
    assert sorted(order[flagged(heads[order], across[order], down[order])].tolist()) == wrong


def test_the_outermost_beams_and_those_of_a_single_beam_sounder_are_not_judged():
    ping, across, down = swath()
    down[5 * BEAMS] += 30.0
    assert flagged(ping, across, down) == []
    assert flagged(np.arange(500), np.zeros(500), np.random.default_rng(3).uniform(5, 500, 500)) == []
    assert flagged(np.empty(0, np.int64), np.empty(0), np.empty(0)) == []


@pytest.mark.parametrize(("name", "value"), [("sigmas", -1.0), ("depth_share", 1.5)])
def test_numbers_that_no_filter_has_are_refused(name: str, value: float):
    with pytest.raises(ValueError, match=f"^{name} is {value}"):
        replace(HOW, **{name: value})


def test_a_blunder_keeps_its_row_and_counts_as_an_outlier(tmp_path: Path):
    raw = rows(pings=9, beams=31)
    raw["down_m"] = 30.0
    raw.loc[4 * 31 + 12, "down_m"] = 60.0
    raw.loc[7, "quality"] = 1
    raw.loc[8, "down_m"] = 5e6
    survey = read_whole(parquet(tmp_path / "raw.parquet", raw), replace(SETTINGS, outliers=HOW))
    assert survey.report["flagged"] == {"rejected": 1, "impossible": 1, "outliers": 1}
    assert survey.soundings["quality"][4 * 31 + 12] == recording.OUTLIER
    assert survey.report["valid"] == 9 * 31 - 3 == (survey.soundings["quality"] == 0).sum()
    assert read_whole(tmp_path / "raw.parquet").report["flagged"]["outliers"] == 0


@pytest.mark.parametrize("size", [1, 40, 62, 100, 1000])
def test_the_verdict_on_a_sounding_does_not_depend_on_the_batch_it_is_read_in(tmp_path, monkeypatch, size):
    raw = rows(pings=24, beams=31)
    raw["down_m"] = 30.0
    rocks = [n * 31 + 9 for n in (5, 6, 7, 11, 12, 13)]
    blunders = [n * 31 + 20 for n in (0, 1, 4, 8, 15, 16, 22)]
    raw.loc[[*rocks, *blunders], "down_m"] = 24.0
    raw.loc[33, "down_m"] = np.nan
    path, settings = parquet(tmp_path / "raw.parquet", pd.concat([raw, raw.tail(2)])), replace(SETTINGS, outliers=HOW)
    expected = read_whole(path, settings)
    assert np.flatnonzero(expected.soundings["quality"] == recording.OUTLIER).tolist() == [
        row - (row > 33) for row in blunders
    ]
    monkeypatch.setattr("pointnetkl.readers.georeference.PART", size)
    again = read_whole(path, settings)
    pd.testing.assert_frame_equal(again.soundings, expected.soundings)
    assert again.report == expected.report


def test_submaps_that_another_program_has_cut_are_not_searched_for_errors_of_a_swath(tmp_path, monkeypatch):
    down = np.full(31, 30.0)
    down[12] = 60.0
    survey = read_toy(tmp_path, monkeypatch, [(np.nan, 0.0, down)], SUBMAPS)
    assert survey.report["flagged"]["outliers"] == 0


def read_toy(folder: Path, monkeypatch: pytest.MonkeyPatch, pings: list, kind: str = SWATHS) -> Whole:
    """Read a file whose pings are (time, place eastwards, depths of its beams)."""
    time, east, downs = zip(*pings, strict=True)
    table = pd.DataFrame(dict.fromkeys(PING_COLUMNS, 0.0), index=range(len(pings)))
    table = table.assign(time_s=time, east=np.add(east, 5e5), north=6e6, depth_m=5.0)
    soundings = [
        pd.DataFrame(dict.fromkeys(SOUNDING_COLUMNS, 0.0), index=range(len(down))).assign(
            ping=number, beam=range(len(down)), across_m=np.arange(len(down)), down_m=down
        )
        for number, down in enumerate(downs)
    ]
    part = Recording("toy.toy", "EPSG:32633", table, pd.concat(soundings).astype({"quality": np.int8}), kind=kind)
    module = SimpleNamespace(SUFFIXES=(".toy",), begins=lambda head: head == b"toy", read=lambda path: iter([part]))
    monkeypatch.setitem(formats.FORMATS, "toy", module)
    (folder / "toy.toy").write_bytes(b"toy")
    return read_whole(folder / "toy.toy", replace(SETTINGS, outliers=HOW))


def test_a_ping_that_is_stored_twice_counts_once_and_two_heads_are_kept(tmp_path, monkeypatch):
    port, starboard = np.full(12, 30.0), np.full(12, 31.0)
    pings = [(1e9 + t, 5.0 * t, down) for t in range(6) for down in (port + t, starboard + t)]
    survey = read_toy(tmp_path, monkeypatch, [*pings, *pings[4:7], pings[4]])
    assert survey.report["skipped"] == {"pings that stand twice": 4, "soundings of skipped pings": 48}
    assert len(survey.pings) == 12
    assert len(survey.soundings) == 144
    assert survey.report["pings"] == 16


def test_pings_of_one_time_and_place_that_differ_in_one_sounding_are_both_kept(tmp_path, monkeypatch):
    down = np.full(12, 30.0)
    other = down.copy()
    other[5] += 0.01
    survey = read_toy(tmp_path, monkeypatch, [(1e9 + t, 5.0 * t, down_m) for t in range(6) for down_m in (down, other)])
    assert survey.report["skipped"] == {}


def test_pings_without_soundings_are_no_copies_of_each_other(tmp_path, monkeypatch):
    empty = np.empty(0)
    pings = [(1e9 + t, 5.0 * t, np.full(12, 30.0)) for t in range(6)]
    survey = read_toy(tmp_path, monkeypatch, [*pings, (1e9 + 6, 30.0, empty), (1e9 + 6, 30.0, empty)])
    assert len(survey.pings) == 8


def test_pings_out_of_order_are_sorted_and_counted(tmp_path, monkeypatch):
    pings = [(1e9 + t, 5.0 * t, np.full(12, 30.0 + t)) for t in range(8)]
    straight = read_toy(tmp_path, monkeypatch, pings)
    mixed = read_toy(tmp_path, monkeypatch, [pings[k] for k in (0, 1, 4, 2, 3, 5, 7, 6)])
    assert (straight.report["reordered"], mixed.report["reordered"]) == (0, 3)
    pd.testing.assert_frame_equal(mixed.soundings, straight.soundings)
