"""What is believed of navigation before any loop closure: files that are held, and fixes of position."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pyproj import Proj

import raw_survey
from pointnetkl.correction.result import CorrectionError
from pointnetkl.correction.solution import belief
from pointnetkl.slam.closing import solving
from pointnetkl.slam.closing.estimate import Estimate
from raw_survey import CRS, EAST, NORTH

PINGS = raw_survey.pings()
ORIGIN = EAST, NORTH


def rows(at: float, east_m: float, north_m: float, sigma_m: float = 0.5) -> dict[str, float]:
    """Return a fix by which the vehicle is so far from where it believed to be at a time."""
    x, y = (np.interp(at, PINGS["time_s"], PINGS[name]) for name in ("x_m", "y_m"))
    return {"time_s": at, "sigma_m": sigma_m, "x_m": EAST + x + east_m, "y_m": NORTH + y + north_m}


def table(path: Path, *fixes: dict[str, Any]) -> Path:
    pd.DataFrame(fixes).to_csv(path, index=False)
    return path


def solved(path: Path, name: str = "usbl", crs: str = CRS) -> np.ndarray:
    """Return how fixes move submaps (n, 3)."""
    navigation = raw_survey.navigation(PINGS, name)
    anchors = belief.fixes(path, crs, ORIGIN, PINGS, navigation)
    estimate = solving.solve(Estimate(navigation.poses, navigation.covariance()), anchors)
    return np.asarray(estimate.poses - navigation.poses)


def test_a_sure_fix_moves_the_submap_there(tmp_path: Path):
    navigation = raw_survey.navigation(PINGS, "usbl")
    moved = solved(table(tmp_path / "a.csv", rows(float(navigation.time_s[10]), 2.0, -3.0, 0.01)))
    assert moved[10, :2] == pytest.approx([2.0, -3.0], abs=0.02)


def test_fixes_are_weighed_by_their_sigma(tmp_path: Path):
    at = float(raw_survey.navigation(PINGS, "usbl").time_s[10])
    moved = solved(table(tmp_path / "a.csv", rows(at, 1.0, 0.0, 0.1), rows(at, 11.0, 0.0, 1.0)))
    assert moved[10, 0] == pytest.approx(1.0 + 10.0 / 101, abs=0.02)


def test_a_fix_between_two_submaps_moves_the_place_of_its_time(tmp_path: Path):
    navigation = raw_survey.navigation(PINGS, "usbl")
    at = 0.4 * float(navigation.time_s[9]) + 0.6 * float(navigation.time_s[10])
    ties = belief.fixes(table(tmp_path / "a.csv", rows(at, 2.0, -3.0)), CRS, ORIGIN, PINGS, navigation)
    (tie,) = (closure.tie for closure in ties)
    there = [np.interp(at, PINGS["time_s"], PINGS[name]) for name in ("x_m", "y_m")]
    turned = navigation.poses.copy()
    turned[tie.source, 2] += np.pi / 2
    assert tie.source == 10
    assert tie.offset(navigation.poses) == pytest.approx([0, 0], abs=1e-9)
    arm = np.array(there) - navigation.poses[10, :2]
    assert tie.offset(turned) == pytest.approx(np.array([-arm[1], arm[0]]) - arm, abs=1e-9)


def test_fixes_on_earth_are_those_on_the_map(tmp_path: Path):
    fix = rows(float(PINGS["time_s"].iloc[300]), 2.0, -3.0)
    longitude, latitude = Proj(CRS)(fix["x_m"], fix["y_m"], inverse=True)
    earth = {name: fix[name] for name in ("time_s", "sigma_m")} | {"lon_deg": longitude, "lat_deg": latitude}
    on_map, on_earth = (solved(table(tmp_path / f"{k}.csv", row)) for k, row in enumerate((fix, earth)))
    np.testing.assert_allclose(on_earth, on_map, atol=1e-5)


def test_a_fix_moves_all_of_an_absolute_track_less_and_less_with_time(tmp_path: Path):
    navigation = raw_survey.navigation(PINGS, "usbl")
    moved = solved(table(tmp_path / "a.csv", rows(float(navigation.time_s[0]), 2.0, 0.0, 0.01)))[:, 0]
    assert moved[0] == pytest.approx(2.0, abs=0.05)
    assert (np.diff(moved[1:]) < 0).all()
    assert moved[-1] > 0


def test_columns_may_be_in_any_order_and_case_with_others_among_them(tmp_path: Path):
    fix = rows(float(PINGS["time_s"].iloc[300]), 2.0, -3.0)
    plain = solved(table(tmp_path / "a.csv", fix))
    mixed = {name.upper() + " ": value for name, value in reversed(fix.items())} | {"remark": "by hand"}
    np.testing.assert_array_equal(solved(table(tmp_path / "b.csv", mixed)), plain)


def test_fixes_of_other_times_and_without_numbers_are_passed_over(tmp_path: Path):
    begin, end = PINGS["time_s"].iloc[[0, -1]]
    good = rows(float(begin) + 50, 2.0, -3.0)
    odd = [good | {"time_s": begin - 1}, good | {"time_s": end + 1}, good | {"x_m": np.nan}]
    odd += [good | {"sigma_m": sigma} for sigma in (0.0, -1.0, np.nan)] + [good | {"time_s": np.nan}]
    navigation = raw_survey.navigation(PINGS)
    path = table(tmp_path / "a.csv", *odd, good)
    assert len(belief.fixes(path, CRS, ORIGIN, PINGS, navigation)) == 1


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", "is no table of fixes"),
        ("\x00\xff", "is no table of fixes"),
        ("time_s,x_m,y_m\n1,2,3\n", "lacks the column sigma_m"),
        ("time_s,sigma_m\n1,2\n", "lacks columns of a place"),
        ("time_s,sigma_m,x_m\n1,2,3\n", "lacks columns of a place"),
        ("time_s,sigma_m,x_m,y_m\n2017-07-14,1,2,3\n", "column time_s holds a word"),
        ("time_s,sigma_m,x_m,y_m\n1,2,3,four\n", "column y_m holds a word"),
        ("time_s,sigma_m,x_m,y_m\n1,2,3,4\n", "none of its 1 fixes is of the survey's time"),
        ("time_s,sigma_m,x_m,y_m\n", "has no fix below its line of names"),
        ("time_s,sigma_m,lon_deg,lat_deg\n1500000050,1,15,inf\n", "none of its 1 fixes is of the survey's time"),
        ("time_s,sigma_m,lon_deg,lat_deg\n1500000050,1,15,954\n", "a.csv"),
    ],
)
def test_a_bad_table_is_one_sentence(tmp_path: Path, content: str, sentence: str):
    (tmp_path / "a.csv").write_bytes(content.encode("latin-1"))
    with pytest.raises(CorrectionError, match=re.escape(sentence)) as ended:
        belief.fixes(tmp_path / "a.csv", CRS, ORIGIN, PINGS, raw_survey.navigation(PINGS))
    assert str(tmp_path / "a.csv") in str(ended.value)
    assert "\n" not in str(ended.value)


@pytest.mark.parametrize("name", ["gone.csv", "folder"])
def test_a_table_that_cannot_be_read_is_one_sentence(tmp_path: Path, name: str):
    (tmp_path / "folder").mkdir()
    with pytest.raises(CorrectionError, match=f"{name}: is no table of fixes"):
        belief.fixes(tmp_path / name, CRS, ORIGIN, PINGS, raw_survey.navigation(PINGS))


def test_fixes_on_earth_of_a_survey_without_a_place_are_refused(tmp_path: Path):
    path = table(tmp_path / "a.csv", {"time_s": 1.5e9, "sigma_m": 1.0, "lon_deg": 15.0, "lat_deg": 54.0})
    with pytest.raises(CorrectionError, match="give them as x_m, y_m"):
        belief.fixes(path, "local", (0.0, 0.0), PINGS, raw_survey.navigation(PINGS))


def test_submaps_of_held_files_stay_and_others_may_not():
    navigation = raw_survey.navigation(PINGS)
    ties = belief.held(["line_1.all"], PINGS, navigation)
    assert [tie.tie.source for tie in ties] == list(range(7, 14))  # all of line 1
    held = Estimate(navigation.poses, navigation.covariance())
    sure = solving.solve(held, ties)
    assert sure.poses == pytest.approx(navigation.poses)
    sigma = np.sqrt(sure.marginals[:, 0, 0])
    assert sigma[7:14].max() < 0.011
    assert sigma[-1] > 5 * sigma[7:14].max()


def test_a_file_that_is_not_of_the_survey_cannot_be_held():
    with pytest.raises(CorrectionError, match=r"other\.all: .* no file of this survey; it has line_0\.all, .* 1 more"):
        belief.held(["line_0.all", "other.all"], PINGS, raw_survey.navigation(PINGS))
