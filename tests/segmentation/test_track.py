"""Lines end where surveyors end them: at gaps and turns, whatever the noise of headings and positions."""

import numpy as np
import pandas as pd
import pytest

import whole_survey
from pointnetkl import segmentation
from pointnetkl.segmentation import track
from pointnetkl.surveys.survey import PINGS

LENGTH_M, GAP_M, TURN_RAD = 100.0, 30.0, 1.0
LINE_M = 400.0


def straight(length_m: float, step_m: float = 1.3) -> np.ndarray:
    """Return places (n, 2) along a line eastwards from the origin."""
    return np.c_[np.arange(0.0, length_m + 1e-9, step_m), np.zeros(int((length_m + 1e-9) / step_m) + 1)]


def moved(xy: np.ndarray, east: float, north: float) -> np.ndarray:
    """Return places (n, 2) moved."""
    return xy + np.array([east, north])


def u_turn(radius_m: float, step_m: float = 1.3) -> np.ndarray:
    """Return the places (n, 2) of a half circle to port, from the origin on eastwards."""
    angle = np.arange(step_m, np.pi * radius_m, step_m) / radius_m
    return radius_m * np.c_[np.sin(angle), 1 - np.cos(angle)]


def there_and_back(radius_m: float, logged: bool, step_m: float = 1.3) -> np.ndarray:
    """Return two lines (n, 2) to and fro, with or without the pings of the turn between them."""
    line = straight(LINE_M, step_m)
    turn = moved(u_turn(radius_m, step_m), LINE_M, 0.0)
    back = moved(line[::-1], 0.0, 2 * radius_m)
    return np.concatenate([line, turn, back] if logged else [line, back])


def headings(xy: np.ndarray) -> np.ndarray:
    """Return the direction (n,) in which each place is left, or reached if it is the last of its line, radians."""
    step = np.diff(xy, axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])[[*range(len(step)), -1]]
    last = np.flatnonzero(np.hypot(*step.T) > 5.0)
    yaw[last] = yaw[last - 1]
    return yaw


def cut(xy: np.ndarray, yaw: np.ndarray | None = None, turn_rad: float = TURN_RAD) -> track.Track:
    """Cut a track as the defaults do."""
    return track.cut(xy, headings(xy) if yaw is None else yaw, LENGTH_M, GAP_M, turn_rad)


def middles(xy: np.ndarray, lines: track.Track) -> np.ndarray:
    """Return the places (k, 2) of the stretches' middle pings."""
    return xy[[stretch.middle for stretch in lines.stretches]]


@pytest.mark.parametrize("radius_m", [10.0, 20.0, 40.0, 60.0])
def test_a_turn_that_is_logged_is_in_no_stretch_and_its_lines_are_cut_as_if_it_were_not(radius_m: float):
    xy, without = there_and_back(radius_m, True), there_and_back(radius_m, False)
    lines, expected = cut(xy), cut(without)
    assert len(lines.stretches) == len(expected.stretches) == 8
    assert [stretch.line for stretch in lines.stretches] == [0] * 4 + [1] * 4
    assert np.abs(middles(xy, lines) - middles(without, expected)).max() < 0.07 * LENGTH_M
    assert np.abs(np.sin([stretch.yaw for stretch in lines.stretches])).max() < 0.01
    assert lines.pings_turning == pytest.approx(len(u_turn(radius_m)), rel=0.1)


def test_noisy_headings_and_positions_make_no_turn_of_a_line():
    rng = np.random.default_rng(0)
    xy = straight(2000.0)
    noisy = cut(xy + rng.normal(0, 0.5, xy.shape), rng.normal(0, 0.15, len(xy)))
    assert (noisy.pings_turning, noisy.lines) == (0, 1)
    assert len(noisy.stretches) == pytest.approx(20, abs=2)


def test_noisy_headings_and_positions_hide_no_turn():
    rng = np.random.default_rng(1)
    xy = there_and_back(40.0, True)
    lines = cut(xy + rng.normal(0, 0.3, xy.shape), headings(xy) + rng.normal(0, 0.15, len(xy)))
    assert lines.lines == 2
    assert np.abs(np.sin([stretch.yaw for stretch in lines.stretches])).max() < 0.15


def test_a_slow_vehicle_that_pings_often_turns_where_a_fast_one_does():
    slow, fast = (cut(there_and_back(40.0, True, step_m)) for step_m in (0.05, 2.0))
    assert 0.05 * slow.pings_turning == pytest.approx(2.0 * fast.pings_turning, abs=8.0)
    assert len(slow.stretches) == len(fast.stretches) == 8


def test_submaps_are_cut_from_the_lines_and_the_turn_is_counted():
    xy = there_and_back(40.0, True)
    yaw = headings(xy)
    pings = pd.DataFrame(dict.fromkeys(PINGS.names, 0.0), index=range(len(xy)))
    pings = pings.assign(ping=range(len(xy)), time_s=range(len(xy)), x_m=xy[:, 0], y_m=xy[:, 1], yaw_rad=yaw)
    ping, across = np.repeat(range(len(xy)), 25), np.tile(np.linspace(-30, 30, 25), len(xy))
    x, y = xy[ping, 0] - across * np.sin(yaw[ping]), xy[ping, 1] + across * np.cos(yaw[ping])
    soundings = pd.DataFrame({"ping": ping, "beam": 0, "x_m": x, "y_m": y, "z_m": -30.0, "quality": 0})
    settings = segmentation.Settings(0, GAP_M, TURN_RAD)
    lines = whole_survey.cut(segmentation.segment, "turning", pings, [soundings], LENGTH_M, 3.0, settings)
    assert len(lines.submaps) == 8
    assert lines.dropped["pings on turns"] == pytest.approx(np.pi * 40.0 / 1.3, rel=0.1)
    assert max(np.ptp(cloud.points[:, 1]) for cloud in lines.submaps) < 70.0
    assert lines.poses["pings"].sum() + lines.dropped["pings on turns"] + lines.dropped["pings in them"] == len(xy)


def test_a_bend_gentler_than_the_limit_ends_no_line():
    angle = np.linspace(0, 1.5, 600)
    bend = 400 * np.c_[np.sin(angle), 1 - np.cos(angle)]  # 0.25 rad in a stretch's length
    assert (cut(bend).pings_turning, cut(bend).lines) == (0, 1)
    assert cut(bend, turn_rad=0.2).pings_turning == len(bend)


def test_a_straight_line_is_cut_from_its_first_ping_to_its_last():
    lines = cut(straight(LINE_M, 1.0))
    assert [stretch.first for stretch in lines.stretches] == [0, 100, 200, 300]
    assert [stretch.last for stretch in lines.stretches] == [100, 200, 300, 401]
    assert (lines.pings_turning, lines.gaps, lines.remainders) == (0, 0, 0)


def test_a_vehicle_at_anchor_makes_no_way():
    rng = np.random.default_rng(2)
    moored = rng.normal(0, 0.4, (20_000, 2))  # some 14 km of zigzag
    assert cut(moored, np.zeros(len(moored))).stretches == []
    hovering = np.concatenate([straight(150.0), moved(moored, 150.0, 0.0), moved(straight(150.0), 150.0, 0.0)])
    assert [stretch.straight for stretch in cut(hovering, np.zeros(len(hovering))).stretches] == [True] * 3


def test_a_gap_in_a_line_is_counted_and_the_way_to_the_next_line_is_not():
    line = straight(LINE_M, 1.0)
    holed = np.delete(line, slice(120, 170), axis=0)
    lines = cut(np.concatenate([holed, moved(line[::-1], 0.0, 80.0)]))
    assert (lines.gaps, lines.missed_m, lines.lines) == (1, 51.0, 3)
    one_way = np.concatenate([line, moved(line, 0.0, 80.0)])  # sailed back without a ping
    assert cut(one_way, np.zeros(len(one_way))).gaps == 0
