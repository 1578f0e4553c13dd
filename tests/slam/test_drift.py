"""The drift of dead reckoning: its covariance against the simulator's, by Monte Carlo, and by reason."""

import dataclasses

import numpy as np
import pytest

from drifts import STRAIGHT, of_vehicle, sailed
from pointnetkl.simulation import vehicle
from pointnetkl.slam.closing import drift
from pointnetkl.slam.closing.drift import DriftError, Fix

HUGIN = vehicle.Navigation(0.001, 0.03, 0.002, 300.0)
DRIFT = of_vehicle(HUGIN)
LAGS = (1, 4, 12, 30)
SEEDS = 400


def nees(errors: np.ndarray, covariance: np.ndarray) -> float:
    """Return the mean over draws of e^T C^-1 e / size for errors (draws, size)."""
    return float(np.mean(np.sum(errors * np.linalg.solve(covariance, errors.T).T, axis=1)) / errors.shape[1])


def relative(errors: np.ndarray, covariance: np.ndarray, xy: np.ndarray, i: int, j: int) -> float:
    """Return the NEES of pose j in the frame of pose i, for errors (draws, n, 3)."""
    dx, dy = xy[j] - xy[i]
    J = np.hstack([-np.array([[1.0, 0, -dy], [0, 1, dx], [0, 0, 1]]), np.eye(3)])
    rows = np.r_[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
    return nees(errors[:, [i, j]].reshape(len(errors), 6) @ J.T, J @ covariance[np.ix_(rows, rows)] @ J.T)


@pytest.fixture(scope="module")
def survey() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return errors (draws, n, 3) of the simulator's navigation, their covariance and the places (n, 2)."""
    time_s, xy, errors, fix = sailed(HUGIN, SEEDS)
    return errors, drift.covariance(time_s, xy, DRIFT, fix), xy


def test_poses_of_the_simulator_have_the_nees_of_1_at_the_end_of_a_track(survey):
    errors, covariance, _ = survey
    assert nees(errors[:, -1], covariance[-3:, -3:]) == pytest.approx(1, abs=0.15)


def test_all_poses_together_have_the_nees_of_1(survey):
    errors, covariance, _ = survey
    n = errors.shape[1]
    marginal = [nees(errors[:, i], covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]) for i in range(n)]
    assert np.mean(marginal) == pytest.approx(1, abs=0.15)
    assert nees(errors.reshape(SEEDS, -1), covariance) < 1.3


@pytest.mark.parametrize("lag", LAGS)
def test_relative_poses_have_the_nees_of_1_at_every_lag(survey, lag: int):
    errors, covariance, xy = survey
    of_pairs = [relative(errors, covariance, xy, i, i + lag) for i in range(0, len(xy) - lag, 3)]
    assert 0.8 < np.mean(of_pairs) < 1.2


def test_edges_of_white_noise_are_too_sure_of_the_end_of_a_track(survey):
    errors, covariance, xy = survey
    edges = np.zeros((3, 3))
    for i in range(len(xy) - 1):
        rows = slice(3 * i, 3 * i + 6)
        J = np.hstack([-np.eye(3), np.eye(3)])
        edges += J @ covariance[rows, rows] @ J.T
    assert nees(errors[:, -1, :2], edges[:2, :2]) > 1.5 * nees(errors[:, -1, :2], covariance[-3:-1, -3:-1])


def test_a_scale_error_alone_grows_with_the_distance_from_the_fix_and_is_gone_on_return():
    time_s, xy = np.arange(5) * 50.0, np.array([[0, 0], [100, 0], [200, 0], [100, 0], [0, 0]], float)
    settings = dataclasses.replace(DRIFT, scale_error=0.01, heading_bias_rad=0, heading_walk_rad=0, velocity_walk_mps=0)
    sigma = np.sqrt(np.diag(drift.covariance(time_s, xy, settings)))
    assert sigma[::3] == pytest.approx([0.01, 1, 2, 1, 0.01], abs=1e-4)
    assert sigma[1::3] == pytest.approx(np.full(5, 0.01))


def test_a_heading_bias_turns_the_map_about_the_fix():
    settings = dataclasses.replace(DRIFT, scale_error=0, heading_bias_rad=0.01, heading_walk_rad=0, velocity_walk_mps=0)
    sigma = np.sqrt(np.diag(drift.covariance(*STRAIGHT, settings)))
    assert sigma[1::3] == pytest.approx(np.hypot(0.01 * STRAIGHT[1][:, 0], 0.01))
    assert sigma[2::3] == pytest.approx(np.full(len(STRAIGHT[0]), 0.01), rel=1e-4)


def test_a_walk_that_never_ends_is_a_constant_and_a_short_one_grows_with_the_root_of_time():
    def at_end(correlation_s: float) -> float:
        settings = drift.Settings(0, 0, 0, 1.0, 0.01, correlation_s)
        return float(np.sqrt(drift.covariance(*STRAIGHT, settings)[-3, -3]))

    time_s = STRAIGHT[0][-1]
    assert at_end(1e9) == pytest.approx(0.01 * time_s, rel=1e-3)
    assert at_end(1.0) == pytest.approx(0.01 * np.sqrt(2 * time_s), rel=0.01)


def test_the_covariance_does_not_depend_on_poses_between():
    time_s, xy = STRAIGHT
    few = drift.covariance(time_s[::2], xy[::2], DRIFT)
    rows = np.arange(3 * len(time_s)).reshape(-1, 3)[::2].ravel()
    assert drift.covariance(time_s, xy, DRIFT)[np.ix_(rows, rows)] == pytest.approx(few, rel=1e-9, abs=1e-12)


def test_a_fix_before_the_first_pose_makes_that_pose_uncertain():
    time_s, xy = STRAIGHT
    later = drift.covariance(time_s + 100.0, xy + np.array([200.0, 0.0]), DRIFT, Fix(0.0, 0.0, 0.0))
    assert later[0, 0] > 100 * drift.covariance(time_s, xy, DRIFT)[0, 0]


@pytest.mark.parametrize("name", sorted(set(drift.PRESETS) - {"gnss", "usbl"}))
def test_a_preset_drifts_by_the_share_of_distance_that_it_states(name: str):
    stated = {"navigation_grade": (0.0005, 0.002), "gyrocompass": (0.0015, 0.004), "compass": (0.008, 0.02)}[name]
    noise = drift.edge_noise(500.0, 1000.0, drift.PRESETS[name])
    cov = drift.covariance(np.array([0.0, 500.0]), np.array([[0.0, 0], [1000, 0]]), drift.PRESETS[name])
    assert stated[0] < np.sqrt(np.trace(cov[3:5, 3:5])) / 1000 < stated[1]
    assert noise.x_m > 0.9 * drift.PRESETS[name].scale_error * 1000


@pytest.mark.parametrize(("name", "sigma_m"), [("gnss", 0.5), ("usbl", 3.0)])
def test_absolute_positions_are_as_sure_at_any_distance_and_do_not_begin_at_a_fix(name: str, sigma_m: float):
    time_s, xy = STRAIGHT
    rates = drift.PRESETS[name]
    for fix in (None, Fix(-10.0, -20.0, 0.0)):
        sigma = np.sqrt(np.diag(drift.covariance(time_s, xy, rates, fix))).reshape(-1, 3)
        position = np.hypot(sigma_m, rates.position_noise_m)
        assert sigma == pytest.approx(np.tile([position, position, 2e-3], (len(time_s), 1)))


def test_absolute_positions_wander_together_and_apart():
    settings = drift.Settings(0, 0, 0, 1.0, 0, 1.0, position_walk_m=3.0, position_correlation_s=100.0)
    time_s, xy = np.array([0.0, 1.0, 100.0, 1e5]), np.zeros((4, 2))
    C = drift.covariance(time_s, xy, settings)
    assert C[0, 3] == pytest.approx(9 * np.exp(-0.01))
    assert C[0, 6] == pytest.approx(9 * np.exp(-1))
    assert C[0, 9] == pytest.approx(0, abs=1e-9)
    assert C[0, 4] == C[0, 5] == 0  # x says nothing of y and of yaw
    assert C[1::3, 1::3] == pytest.approx(C[::3, ::3])


def test_a_wander_adds_to_drift():
    time_s, xy = STRAIGHT
    wander = dataclasses.replace(DRIFT, position_walk_m=2.0, position_correlation_s=50.0)
    alone = drift.Settings(0, 0, 0, 1.0, 0, 1.0, 2.0, 50.0, position_noise_m=1e-9, yaw_noise_rad=1e-9)
    both = drift.covariance(time_s, xy, DRIFT) + drift.covariance(time_s, xy, alone)
    assert drift.covariance(time_s, xy, wander) == pytest.approx(both, abs=1e-12)


def test_rates_multiplied_multiply_sigmas_and_keep_times():
    usbl = drift.PRESETS["usbl"]
    rates = usbl.times(2.0)
    assert (rates.position_walk_m, rates.position_noise_m) == (2 * usbl.position_walk_m, 2 * usbl.position_noise_m)
    assert rates.position_correlation_s == usbl.position_correlation_s


@pytest.mark.parametrize(
    "change",
    [
        {"position_walk_m": -1.0},
        {"position_walk_m": 1e5},
        {"position_correlation_s": 0.0},
        {"heading_correlation_s": np.inf},
        {"position_noise_m": 0.0},
    ],
)
def test_rates_out_of_range_are_refused_by_their_name(change: dict):
    (name,) = change
    with pytest.raises(ValueError, match=f"^{name} is"):
        dataclasses.replace(DRIFT, **change)


def test_times_that_do_not_grow_are_refused():
    with pytest.raises(DriftError, match="pose 2 has no later time than the one before"):
        drift.covariance(np.array([0.0, 1.0, 1.0]), np.zeros((3, 2)), DRIFT)
