"""Many files make one survey, with any number of workers; their soundings are kept on disk, and none is lost."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import all_files
from all_files import starts
from generic_files import parquet, rows
from pointnetkl import readers
from pointnetkl.readers import formats, spool
from pointnetkl.readers.formats import kongsberg_all, recording
from pointnetkl.surveys.survey import SurveyError
from whole_survey import read


@pytest.fixture
def lines(tmp_path: Path) -> Path:
    """A folder of four files, whose names are not in the order of time."""
    for number, name in enumerate(("line_2.all", "line_10.all", "line_1.all", "line_9.all")):
        (tmp_path / name).write_bytes(all_files.survey(6, begin=all_files.BEGIN + 6 * number))
    return tmp_path


def test_a_survey_is_the_same_with_any_number_of_workers(lines: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(readers, "_SMALL_BYTES", 0)
    surveys = []
    for workers in ("1", "2", "3"):
        monkeypatch.setenv("POINTNETKL_WORKERS", workers)
        surveys.append(read(lines))
    for other in surveys[1:]:
        pd.testing.assert_frame_equal(other.pings, surveys[0].pings)
        pd.testing.assert_frame_equal(other.soundings, surveys[0].soundings)
        assert other.report == surveys[0].report
    names = ["line_2.all", "line_10.all", "line_1.all", "line_9.all"]
    assert surveys[0].pings["file"].drop_duplicates().tolist() == names
    assert surveys[0].pings["time_s"].is_monotonic_increasing


def test_parts_of_any_size_make_the_same_survey(lines: Path, monkeypatch: pytest.MonkeyPatch):
    expected = read(lines)
    for size in (1, 50, 1000):
        for module in ("formats.kongsberg_all", "georeference"):
            monkeypatch.setattr(f"pointnetkl.readers.{module}.PART", size)
        again = read(lines)
        pd.testing.assert_frame_equal(again.soundings, expected.soundings)
        pd.testing.assert_frame_equal(again.pings, expected.pings)


def test_pings_of_two_files_at_once_are_put_in_turns(tmp_path: Path):
    table = rows(pings=20, heading=1.0)
    odd = np.repeat(np.arange(20) % 2 == 1, 5)
    parquet(tmp_path / "port.parquet", table[odd])
    parquet(tmp_path / "starboard.parquet", table[~odd])
    survey = read(tmp_path)
    assert survey.pings["file"].tolist() == ["starboard.parquet", "port.parquet"] * 10
    parquet(tmp_path / "both.parquet", table)
    pd.testing.assert_frame_equal(survey.soundings, read(tmp_path / "both.parquet").soundings)


def test_a_report_names_twenty_places_of_damage_and_counts_the_others(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(kongsberg_all, "PART", 50)
    for file in ("a.all", "b.all"):
        content = bytearray(all_files.survey(120, begin=all_files.BEGIN + 120 * (file == "b.all")))
        for place in starts(content, "X")[:70]:
            content[place + 60] ^= 0x10
        (tmp_path / file).write_bytes(content)
    report = read(tmp_path).report
    assert report["skipped"]["pings with a wrong checksum"] == 140
    assert len(report["problems"]) == 21
    assert report["problems"][-1] == "and 120 more"


def test_what_is_wrong_with_a_whole_file_is_reported_before_the_damage_that_fills_the_report():
    problems = recording.Problems("a.all")
    for place in range(30):
        problems.add(f"byte {place} is damaged")
    problems.add_first("holds no position")
    summary = problems.drain().summary
    assert summary[:2] == ["a.all: holds no position", "a.all: byte 0 is damaged"]
    assert summary[19:] == ["a.all: byte 18 is damaged", "and 11 more"]
    assert (problems.summary, bool(problems)) == ([], False)


def test_nothing_is_left_beside_a_survey_that_was_read_or_refused(lines: Path, tmp_path: Path):
    scratch = tmp_path / "scratch"
    readers.read(lines / "line_1.all", readers.Settings("auto"), lambda part: None, scratch)
    (lines / "bad.gsf").write_bytes(b"no survey")
    with pytest.raises(SurveyError, match=r"bad\.gsf"):
        readers.read(lines / "bad.gsf", readers.Settings("auto"), lambda part: None, scratch)
    assert os.listdir(scratch) == []
    (scratch / ".spool-killed").mkdir()
    readers.read(lines / "line_1.all", readers.Settings("auto"), lambda part: None, scratch)
    assert os.listdir(scratch) == []


def test_a_fault_of_a_reader_is_reported_with_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(formats.FORMATS["GSF"], "read", lambda path: [][0])
    (tmp_path / "line.gsf").write_bytes(b"any")
    with pytest.raises(spool.UnforeseenError, match=r"line\.gsf: the reader of GSF fails on it \(IndexError"):
        spool.fill((tmp_path / "line.gsf", tmp_path / "spool"))
