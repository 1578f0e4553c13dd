"""The correction at every ping: that of the submaps where they are, nothing where navigation begins, and continuous."""

import numpy as np
import pandas as pd
import pytest

import raw_survey
from pointnetkl.correction.result import TRACK
from pointnetkl.correction.solution import track
from pointnetkl.correction.solution.belief import Navigation
from pointnetkl.correction.solution.track import Knots
from pointnetkl.slam.closing import drift, solving
from pointnetkl.slam.closing.estimate import Closure, Estimate, Tie

PINGS = raw_survey.pings(lines=5)
PER_LINE = 7
DIAGONAL = [0, 1, 2]


def drawn(covariance: np.ndarray, seed: int) -> np.ndarray:
    """Return errors (n, 3) of poses of a covariance (3 n, 3 n)."""
    numbers = np.random.default_rng(seed).standard_normal(len(covariance))
    return np.asarray(np.linalg.cholesky(covariance) @ numbers).reshape(-1, 3)


def closures(navigation: Navigation, seed: int = 0) -> list[Closure]:
    """Return closures that agree with one drift, drawn as it is believed."""
    C = navigation.covariance()
    errors = drawn(C, seed)
    found = []
    for source in range(PER_LINE, len(errors), 2):
        opposite = 2 * PER_LINE * (source // PER_LINE) - 1 - source
        tie = Tie.at(navigation.poses, source, [opposite], None, np.array([3.0, 5.0]))
        A, end = np.eye(2) / 0.1, tie.offset(navigation.poses - errors)
        found.append(Closure(tie, A, A @ end, 0.01, end))
    return found


def solved(name: str, closures_: list[Closure] | None = None) -> tuple[Navigation, Estimate, Knots]:
    navigation = raw_survey.navigation(PINGS, name)
    held = closures(navigation) if closures_ is None else closures_
    estimate = solving.solve(Estimate(navigation.poses, navigation.covariance()), held)
    return navigation, estimate, track.solve(PINGS, navigation, navigation.rates, held, estimate.poses)


def at(times: np.ndarray, knots: Knots) -> np.ndarray:
    return np.column_stack([np.interp(times, knots.time_s, knots.moved[:, k]) for k in DIAGONAL])


@pytest.mark.parametrize("name", drift.PRESETS)
def test_at_a_submap_s_own_time_the_correction_is_the_submap_s(name: str):
    navigation, estimate, knots = solved(name)
    moved = estimate.poses - navigation.poses
    # a submap has a noise of its own, which is not its pings'
    noise = navigation.rates.position_noise_m + 0.02 * np.abs(moved[:, :2]).max()
    assert np.abs(at(navigation.time_s, knots) - moved)[:, :2].max() < noise
    assert np.abs(moved[:, :2]).max() > 5 * navigation.rates.position_noise_m


@pytest.mark.parametrize("name", ["navigation_grade", "gyrocompass", "compass"])
def test_where_dead_reckoning_begins_nothing_moves_and_all_is_sure(name: str):
    _, _, knots = solved(name)
    assert knots.time_s[0] == pytest.approx(PINGS["time_s"].iloc[0], abs=0.01)
    assert np.abs(knots.moved[0, :2]).max() < 1e-4
    for covariance in (knots.covariance[0], knots.before[0]):
        assert np.sqrt(covariance[:2, :2].diagonal()) == pytest.approx([0.01, 0.01], rel=0.01)


@pytest.mark.parametrize("name", drift.PRESETS)
def test_closures_make_no_ping_less_sure_and_none_surer_than_sure(name: str):
    _, _, knots = solved(name)
    gain = np.linalg.eigvalsh(knots.before - knots.covariance)
    assert gain.min() > -1e-9
    assert np.linalg.eigvalsh(knots.covariance).min() > 0
    assert gain.max() > 0.1 * np.linalg.eigvalsh(knots.before).max()


@pytest.mark.parametrize("name", drift.PRESETS)
def test_between_lines_it_is_as_sure_as_the_submaps_around(name: str):
    navigation, estimate, knots = solved(name)
    own = np.sqrt([np.interp(navigation.time_s, knots.time_s, knots.covariance[:, k, k]) for k in (0, 1)])
    submaps = np.sqrt(estimate.marginals[:, [0, 1], [0, 1]]).T
    assert own == pytest.approx(submaps, rel=0.1, abs=navigation.rates.position_noise_m)


@pytest.mark.parametrize("name", drift.PRESETS)
def test_without_closures_nothing_moves(name: str):
    _, _, knots = solved(name, [])
    assert not knots.moved.any()
    np.testing.assert_array_equal(knots.covariance, knots.before)


@pytest.mark.parametrize("name", drift.PRESETS)
@pytest.mark.parametrize(("constant", "value"), [("_A_SUBMAP", 6), ("_MOST", 1)])
def test_it_hardly_depends_on_how_many_knots_there_are(
    name: str, constant: str, value: int, monkeypatch: pytest.MonkeyPatch
):
    navigation, _, usual = solved(name)
    monkeypatch.setattr(track, constant, value)
    _, _, other = solved(name)
    assert len(other.time_s) != len(usual.time_s)
    sigma = np.sqrt([np.interp(navigation.time_s, usual.time_s, usual.before[:, k, k]) for k in DIAGONAL]).T
    assert (np.abs(at(navigation.time_s, other) - at(navigation.time_s, usual)) <= 0.05 * sigma + 1e-9).all()


@pytest.mark.parametrize("name", ["gyrocompass", "usbl"])
def test_no_ping_jumps(name: str):
    _, _, knots = solved(name)
    table = track.table(PINGS, knots)
    steps = np.abs(np.diff(table[["moved_x_m", "moved_y_m"]].to_numpy(), axis=0)).max(axis=1)
    longest = np.abs(knots.moved[:, :2]).max()
    within = np.diff(PINGS["time_s"]) < 2
    assert steps[within].max() < 0.03 * longest


def test_the_correction_of_a_drift_of_its_belief_halves_the_error():
    navigation = raw_survey.navigation(PINGS)
    ratios = []
    for seed in range(5):
        C = navigation.covariance()
        errors = drawn(C, seed)
        _, _, knots = solved("gyrocompass", closures(navigation, seed))
        left = errors + at(navigation.time_s, knots)
        ratios.append(np.linalg.norm(left[:, :2]) / np.linalg.norm(errors[:, :2]))
    assert np.mean(ratios) < 0.5


def test_a_track_has_a_row_for_each_ping_and_the_columns_that_are_promised():
    _, _, knots = solved("gyrocompass")
    table = track.table(PINGS, knots)
    assert table.columns.tolist() == TRACK.names
    assert len(table) == len(PINGS)
    np.testing.assert_array_equal(table["x_m"], PINGS["x_m"])
    numbers = table.select_dtypes("number").to_numpy(np.float64)
    assert np.isfinite(numbers).all()
    assert (table["var_xx_m2"] <= table["before_var_xx_m2"]).all()


def test_two_pings_at_one_time_move_alike():
    heads = PINGS.loc[PINGS.index.repeat(2)].reset_index(drop=True)
    heads = heads.assign(ping=np.arange(len(heads), dtype=np.int32))
    navigation, estimate, single = solved("gyrocompass")
    knots = track.solve(heads, navigation, navigation.rates, closures(navigation), estimate.poses)
    np.testing.assert_array_equal(knots.time_s, single.time_s)
    moved = track.table(heads, knots)[["moved_x_m", "moved_y_m", "moved_yaw_rad"]].to_numpy()
    np.testing.assert_array_equal(moved[::2], moved[1::2])


def test_an_unmoved_track_stays_and_nothing_is_known_of_its_sigma():
    table = track.unmoved(PINGS)
    assert table.columns.tolist() == TRACK.names
    np.testing.assert_array_equal(table[["x_m", "y_m"]], PINGS[["x_m", "y_m"]])
    assert not table[["moved_x_m", "moved_y_m", "moved_yaw_rad"]].to_numpy().any()
    assert table[["var_xx_m2", "before_var_yy_m2", "var_yaw_rad2"]].isna().all(axis=None)


def test_a_track_without_pings_has_no_rows():
    table = track.unmoved(PINGS[:0])
    assert table.columns.tolist() == TRACK.names
    assert table.empty


def test_knots_are_at_both_ends_of_every_line_and_a_few_a_submap():
    navigation = raw_survey.navigation(PINGS)
    times = track.knot_times(PINGS["time_s"].to_numpy(), navigation.time_s)
    ends = PINGS.groupby("file")["time_s"].agg(["min", "max"]).to_numpy().ravel()
    for wanted in (ends, navigation.time_s):
        assert np.abs(wanted[:, None] - times).min(axis=1).max() < 0.01
    assert (np.diff(times) > 0).all()
    assert len(times) < 4 * len(navigation.time_s)


@pytest.mark.parametrize("pings", [400, 401])
@pytest.mark.parametrize(("short", "long"), [(0.02, 0.5), (0.0, 0.5), (1e-4, 0.1)])
def test_knots_of_a_dual_swath_are_no_more_than_of_a_single_one(pings: int, short: float, long: float):
    intervals = np.where(np.arange(pings - 1) % 2 == 0, short, long)
    times = 1.5e9 + np.concatenate([[0.0], np.cumsum(intervals)])
    assert len(track.knot_times(times, times[20::40])) < 50


def test_knots_of_a_gap_in_a_line_are_at_its_ends():
    times = 1.5e9 + np.concatenate([np.arange(100.0), 150 + np.arange(100.0)])
    knots = track.knot_times(times, times[[50, 150]])
    assert np.isin(times[[99, 100]], knots).all()


@pytest.mark.parametrize("pings", [1, 2])
def test_a_survey_of_a_few_pings_has_knots(pings: int):
    rows: pd.DataFrame = PINGS[:pings]
    first = raw_survey.navigation(PINGS[:1], every=1)
    knots = track.solve(rows, first, first.rates, [], first.poses)
    table = track.table(rows, knots)
    assert not table[["moved_x_m", "moved_y_m"]].to_numpy().any()
    assert np.isfinite(table["var_xx_m2"]).all()
