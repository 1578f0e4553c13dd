"""Ties that a user gives: the second file moves by their offset against the first, in either order of time."""

import re
from pathlib import Path

import numpy as np
import pytest
from pyproj import Proj

import raw_survey
from pointnetkl.correction.products.ties import TieError
from pointnetkl.correction.result import CorrectionError
from pointnetkl.correction.solution import given
from pointnetkl.slam.closing import solving
from pointnetkl.slam.closing.estimate import Closure, Estimate
from raw_survey import CRS, EAST, NORTH

PINGS = raw_survey.pings()
NAVIGATION = raw_survey.navigation(PINGS, "usbl")
TIMES = NAVIGATION.time_s
PER_LINE = 7  # submaps
COV = "COV {0} 1 0 0 {0} 0 1 0 1 0 0 1\n"


def tie(first: int, second: int, east: float, north: float, sigma: float = 0.01, status: int = 2) -> str:
    """Return a tie between two submaps."""
    files = " ".join(f"/raw/line_{k // PER_LINE}.all" for k in (first, second))
    times = f"{TIMES[first]:.6f} {TIMES[second]:.6f}"
    return f"TIE {files} {status} {times} {east} {north} 7.0\n{COV.format(sigma)}"


def fixed(k: int, east: float, north: float, sigma: float = 0.01, status: int = 2) -> str:
    """Return a global tie of a submap."""
    return f"GLOBALTIE /raw/line_{k // PER_LINE}.all {status} {TIMES[k]:.6f} {east} {north} 0 {sigma} {sigma} 1\n"


def closures(folder: Path, text: str, crs: str = CRS) -> list[Closure]:
    (folder / "ties.txt").write_text(text)
    return given.closures(folder / "ties.txt", crs, (EAST, NORTH), PINGS, NAVIGATION)


def moved(folder: Path, text: str, crs: str = "local") -> np.ndarray:
    """Return how ties move the submaps (n, 2)."""
    start = Estimate(NAVIGATION.poses, NAVIGATION.covariance())
    estimate = solving.solve(start, closures(folder, text, crs))
    return np.asarray(estimate.poses - NAVIGATION.poses)[:, :2]


@pytest.mark.parametrize(("first", "second"), [(2, 20), (20, 2)])
def test_the_second_file_moves_against_the_first_whichever_was_sailed_first(tmp_path: Path, first: int, second: int):
    places = moved(tmp_path, tie(first, second, 3.0, -2.0))
    assert places[second] - places[first] == pytest.approx([3.0, -2.0], abs=0.06)  # yaw gives a little
    assert places[second] == pytest.approx(-places[first], abs=0.1)  # neither is surer


@pytest.mark.parametrize("status", [1, 2, 5, 6])
def test_a_global_tie_moves_the_file_itself(tmp_path: Path, status: int):
    assert moved(tmp_path, fixed(8, 3.0, -2.0, status=status))[8] == pytest.approx([3.0, -2.0], abs=0.05)


def test_ties_of_z_alone_move_nothing(tmp_path: Path):
    assert closures(tmp_path, tie(2, 20, 3.0, -2.0, status=3) + fixed(8, 3.0, -2.0, status=7)) == []


def test_ties_are_weighed_by_their_covariance(tmp_path: Path):
    places = moved(tmp_path, fixed(8, 1.0, 0.0, 0.1) + fixed(8, 11.0, 0.0, 1.0))
    assert places[8, 0] == pytest.approx(1.0 + 10 / 101, abs=0.05)


def test_a_long_axis_hardly_holds_its_direction(tmp_path: Path):
    text = tie(2, 20, 3.0, -2.0)
    s = np.sqrt(0.5)
    turned = f"COV 100 {s} {s} 0 0.01 {-s} {s} 0 1 0 0 1\n"  # north-east is not known
    places = moved(tmp_path, text.split("\n")[0] + "\n" + turned)
    across = (places[20] - places[2]) @ [-s, s]
    along = (places[20] - places[2]) @ [s, s]
    assert across == pytest.approx(np.array([3.0, -2.0]) @ [-s, s], abs=0.06)
    assert abs(along) < 0.1


def test_offsets_are_east_and_north_on_the_ground_and_turn_to_the_map(tmp_path: Path):
    longitude, latitude = Proj(CRS)(EAST, NORTH, inverse=True)
    turn = -np.deg2rad(Proj(CRS).get_factors(longitude, latitude).meridian_convergence)
    assert abs(turn) > 0.02  # away from the zone's middle
    (closure,) = closures(tmp_path, tie(2, 20, 0.0, 10.0))
    # map vector of true north
    assert closure.end == pytest.approx(10.0 * np.array([np.sin(-turn), np.cos(turn)]) * [-1, 1], abs=0.01)


def test_a_tie_of_no_sigma_is_sure_and_not_infinitely_so(tmp_path: Path):
    (closure,) = closures(tmp_path, tie(2, 20, 3.0, -2.0, sigma=0.0))
    assert np.isfinite(closure.A).all()
    assert np.linalg.norm(closure.A, 2) == pytest.approx(1000, rel=0.01)


def test_a_tie_of_a_submap_with_itself_changes_nothing(tmp_path: Path):
    assert np.abs(moved(tmp_path, tie(8, 8, 3.0, -2.0))).max() < 1e-6


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (tie(2, 24, 3.0, -2.0).replace("line_3.all", "other.all"), "a tie of other.all, which is no file"),
        (fixed(8, 1.0, 1.0).replace("line_1.all", "other.all"), "a tie of other.all, which is no file"),
        (
            fixed(8, 1.0, 1.0).replace(f"{TIMES[8]:.6f}", "1400000000.0"),
            "ties line_1.all at 1400000000.000 s, and it is from",
        ),
        (
            tie(2, 24, 1, 1).replace(f"{TIMES[24]:.6f}", "1600000000.0"),
            "ties line_3.all at 1600000000.000 s, and it is from",
        ),
        (fixed(8, 1.0, 1.0).replace("line_1.all", "line_3.all"), "ties line_3.all at 1500000365.000 s, and it is from"),
    ],
)
def test_a_tie_of_another_survey_is_one_sentence(tmp_path: Path, text: str, sentence: str):
    with pytest.raises(CorrectionError, match=re.escape(sentence)) as ended:
        closures(tmp_path, text)
    assert "\n" not in str(ended.value)


def test_a_damaged_list_is_one_sentence(tmp_path: Path):
    with pytest.raises(TieError, match="line 1: COV must follow TIE"):
        closures(tmp_path, tie(2, 20, 3.0, -2.0).split("\n")[0] + "\n")
