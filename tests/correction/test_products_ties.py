"""Tie lists: parsed by their documented columns, read back, and refused by the line."""

import re
from pathlib import Path

import numpy as np
import pytest
from pyproj import Proj

import corrected_survey
import graphs
from pointnetkl.correction.products import ties
from pointnetkl.correction.products.ties import TieError
from pointnetkl.correction.result import Corrected

TIE = "TIE /a/1.all /a/2.all 1 100.5 200.5 1.0 -2.0 0.5\n"
COV = "COV 1 1 0 0 2 0 1 0 3 0 0 1\n"
GLOBALTIE = "GLOBALTIE /a/1.all 2 100.5 1.0 -2.0 0.0 0.1 0.2 9\n"


def written(path: Path, survey: Corrected) -> list[list[str]]:
    ties.write(path / "ties.txt", survey)
    return [line.split() for line in (path / "ties.txt").read_text().splitlines()]


def test_accepted_closures_are_ties_from_the_target_s_file_to_the_source_s(tmp_path: Path):
    survey = corrected_survey.corrected()
    lines = written(tmp_path, survey)
    assert [line[0] for line in lines] == ["TIE", "COV", "TIE", "COV", "GLOBALTIE"]
    assert lines[0][1:4] == ["./first.all", "./first.all", "2"]
    assert lines[2][1:4] == ["./first.all", "./second.all", "2"]
    assert survey.submaps is not None
    np.testing.assert_allclose(np.array(lines[0][4:6], float), survey.submaps.time_s[[1, 4]], atol=1e-6, rtol=0)
    assert lines[4][1:3] == ["./second.all", "2"]
    assert float(lines[4][3]) == pytest.approx(survey.submaps.time_s[8], abs=1e-6)


def test_offsets_are_the_shifts_in_true_east_and_north(tmp_path: Path):
    survey = corrected_survey.corrected()
    line = written(tmp_path, survey)[0]
    shift = survey.closures[["shift_x_m", "shift_y_m"]].iloc[0].to_numpy(float)
    longitude, latitude = Proj(survey.crs)(*(survey.submaps.after[4][:2, 3] + survey.origin), inverse=True)
    turn = -np.deg2rad(Proj(survey.crs).get_factors(longitude, latitude).meridian_convergence)
    east = np.cos(turn) * shift[0] - np.sin(turn) * shift[1]
    north = np.sin(turn) * shift[0] + np.cos(turn) * shift[1]
    np.testing.assert_allclose(np.array(line[6:8], float), [east, north], rtol=1e-3)
    assert float(line[8]) == 0.0


def test_axes_of_a_covariance_make_it_again(tmp_path: Path):
    survey = corrected_survey.corrected()
    written(tmp_path, survey)
    first, second, last = ties.read(tmp_path / "ties.txt")
    assert [tie.is_global for tie in (first, second, last)] == [False, False, True]
    assert first.sigmas_m[0] > first.sigmas_m[1]
    w = np.linalg.eigvalsh(first.covariance[:2, :2])
    np.testing.assert_allclose(w, np.linalg.eigvalsh(corrected_survey.V), rtol=2e-3)
    assert first.covariance[:2, 2].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(np.trace(last.covariance[:2, :2]), np.trace(corrected_survey.V), rtol=2e-3)


def test_what_is_written_comes_back(tmp_path: Path):
    survey = corrected_survey.corrected()
    written(tmp_path, survey)
    again = ties.read(tmp_path / "ties.txt")
    found = ties.of_closures(survey, survey.submaps, ties.measurements(survey, survey.submaps)[0])
    for tie, expected in zip(again, found, strict=True):
        assert (tie.files, tie.status) == (expected.files, expected.status)
        np.testing.assert_allclose(tie.times_s, expected.times_s, atol=1e-6, rtol=0)
        np.testing.assert_allclose(tie.offset_m, expected.offset_m, atol=1e-8)
        np.testing.assert_allclose(tie.covariance, expected.covariance, atol=1e-6)


def test_a_list_of_the_program_is_read(tmp_path: Path):
    (tmp_path / "a").write_text(f"# by hand\n{TIE}{COV}\n{GLOBALTIE}")
    tie, whole = ties.read(tmp_path / "a")
    assert (tie.files, tie.status, tie.times_s) == (("/a/1.all", "/a/2.all"), 1, (100.5, 200.5))
    assert tie.offset_m == (1.0, -2.0, 0.5)
    np.testing.assert_array_equal(tie.covariance, np.diag([1.0, 4.0, 9.0]))
    assert (whole.files, whole.status, whole.times_s) == (("/a/1.all",), 2, (100.5,))
    np.testing.assert_allclose(whole.covariance, np.diag([0.01, 0.04, 81.0]))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (TIE, "line 1: COV must follow TIE"),
        (TIE + GLOBALTIE, "line 2: COV must follow TIE"),
        (COV, "line 1: it begins with 'COV', must be TIE or GLOBALTIE"),
        (TIE.replace(" 0.5\n", "\n") + COV, "line 1: it has 7 words after TIE, must have 8"),
        (TIE + COV.replace(" 1\n", "\n"), "line 2: it has 11 words after COV, must have 12"),
        (TIE.replace("-2.0", "nan") + COV, "line 1: 'nan' is not a finite number"),
        (TIE.replace(" 1 100", " 4 100") + COV, "line 1: its status is '4', must be one of"),
        (TIE.replace(" 1 100", " 1.0 100") + COV, "line 1: its status is '1.0'"),
        (TIE + COV.replace("COV 1 1", "COV 1 2"), "line 2: an axis has not length 1"),
        (TIE + COV.replace("COV 1", "COV -1"), "line 2: a standard deviation is below 0"),
        (GLOBALTIE.replace(" 9", " -9"), "line 1: a standard deviation is below 0"),
        (b"TIE \xff\x00", "line 1: it is no text"),
    ],
)
def test_what_is_no_tie_is_refused_by_its_line(tmp_path: Path, content: str | bytes, sentence: str):
    (tmp_path / "a").write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(TieError, match=re.escape(sentence)):
        ties.read(tmp_path / "a")


def test_a_missing_list_is_an_error_of_ours(tmp_path: Path):
    with pytest.raises(TieError, match="cannot be read"):
        ties.read(tmp_path / "none")


def test_a_damaged_list_is_ties_or_an_error_of_ours(tmp_path: Path):
    rng, path = np.random.default_rng(0), tmp_path / "a"
    whole = ((TIE + COV) * 3 + GLOBALTIE).encode()
    refused = 0
    for _ in range(300):
        path.write_bytes(graphs.mutated(whole, rng))
        try:
            read = ties.read(path)
        except TieError as error:
            graphs.assert_one_sentence(str(error), path)
            refused += 1
        else:
            assert all(np.isfinite(tie.covariance).all() for tie in read)
    assert 100 < refused < 300


def test_ties_of_names_that_the_list_cannot_hold_are_left_out(tmp_path: Path):
    survey = corrected_survey.with_track(corrected_survey.corrected(), file="line 1.all")
    sentences = ties.write(tmp_path / "ties.txt", survey)
    assert "no tie list: it would have no tie" in sentences
    assert "lacks 3 accepted closures of files whose names have a blank" in sentences[-1]
    assert list(tmp_path.iterdir()) == []


def test_a_survey_without_a_place_or_times_has_no_list(tmp_path: Path):
    assert "no place on the earth" in ties.write(tmp_path / "ties.txt", corrected_survey.corrected("local"))[0]
    assert "no pings with times" in ties.write(tmp_path / "ties.txt", corrected_survey.of_submaps())[0]
    assert list(tmp_path.iterdir()) == []
