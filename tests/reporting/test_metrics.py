"""Measures: their invariances, and what they say of errors whose distribution is known."""

import numpy as np
import pytest

from pointnetkl.registration.covariance import metrics

RNG = np.random.default_rng(0)
TRACK = np.cumsum(RNG.normal(size=(50, 3)), axis=0)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def test_rmse_of_a_uniform_offset_is_its_length():
    assert metrics.rmse(TRACK + np.array([3.0, 4.0, 12.0]), TRACK) == pytest.approx(13.0)


def test_rmse_is_unchanged_when_both_trajectories_move_together():
    other = TRACK + RNG.normal(size=TRACK.shape)
    moved = metrics.rmse(turned(other, 0.7) + 5.0, turned(TRACK, 0.7) + 5.0)
    assert moved == pytest.approx(metrics.rmse(other, TRACK))


def test_rmse_to_an_unknown_truth_is_not_a_number():
    assert np.isnan(metrics.rmse(TRACK, np.full_like(TRACK, np.nan)))


@pytest.mark.parametrize("angle", [-3.0, 0.0, 0.4, 2.5])
def test_alignment_undoes_a_turn_and_a_move_in_the_plane_and_leaves_depth_alone(angle: float):
    moved = turned(TRACK, angle) + np.array([100.0, -20.0, 3.0])
    assert metrics.align_se2(moved, TRACK) == pytest.approx(TRACK + np.array([0.0, 0.0, 3.0]))


def test_alignment_never_makes_the_error_larger():
    other = TRACK + RNG.normal(size=TRACK.shape)
    assert metrics.rmse(metrics.align_se2(other, TRACK), TRACK) <= metrics.rmse(other, TRACK)


def gaussian_errors() -> tuple[np.ndarray, np.ndarray]:
    q = np.array([[[2.0, 0.8], [0.8, 0.5]], [[0.01, 0.0], [0.0, 9.0]]])
    draws = RNG.normal(size=(2, 20_000, 2))
    return np.einsum("kij,klj->kli", np.linalg.cholesky(q), draws), q


def test_gaussian_errors_are_calibrated_under_their_own_covariance():
    result = metrics.calibration(*gaussian_errors())
    assert result["nees"] == pytest.approx(1.0, abs=0.02)
    for percent in (50, 90, 95, 99):
        assert result[f"coverage_{percent}"] == pytest.approx(percent / 100, abs=0.01)


def test_a_covariance_four_times_too_small_has_four_times_the_nees_and_covers_less():
    errors, q = gaussian_errors()
    right, small = metrics.calibration(errors, q), metrics.calibration(errors, q / 4)
    assert small["nees"] == pytest.approx(4 * right["nees"])
    assert small["coverage_95"] < right["coverage_95"]


def test_calibration_is_unchanged_by_a_change_of_coordinates():
    errors, q = gaussian_errors()
    A = np.array([[2.0, 1.0], [0.3, -1.0]])
    assert metrics.calibration(errors @ A.T, A @ q @ A.T) == pytest.approx(metrics.calibration(errors, q))


def test_calibration_of_no_errors_is_refused():
    with pytest.raises(metrics.MetricsError, match="cannot be judged"):
        metrics.calibration(np.empty((0, 1, 2)), np.empty((0, 2, 2)))


def draws(count: int, block: int = 1) -> np.ndarray:
    return metrics.resamples(count, np.random.default_rng(1), block)


def test_the_interval_of_a_mean_holds_the_mean_and_narrows_with_more_values():
    values = RNG.normal(size=400)
    low, high = metrics.mean_ci95(values, draws(400))
    few = metrics.mean_ci95(values[:40], draws(40))
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert few[1] - few[0] > high - low


def test_an_interval_of_nothing_is_refused():
    with pytest.raises(metrics.MetricsError):
        draws(0)


def test_drawing_neighbours_together_widens_the_interval_of_values_that_they_share():
    shared = np.repeat(RNG.normal(size=60), 5)
    (low, high), (low_alone, high_alone) = (metrics.mean_ci95(shared, draws(300, block)) for block in (10, 1))
    assert high - low > 1.7 * (high_alone - low_alone)
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(60), rel=0.3)


@pytest.mark.parametrize(("count", "block"), [(1, 5), (2, 5), (7, 5), (50, 5), (50, 1000)])
def test_every_draw_has_as_many_values_as_there_are_and_draws_differ(count: int, block: int):
    which = draws(count, block)
    assert which.shape[1] == count
    assert (which.min(), which.max()) == (0, count - 1)
    assert count == 1 or len(np.unique(np.sort(which, axis=1), axis=0)) > 1


def test_of_two_alike_neither_is_better_in_more_than_about_half_of_the_draws():
    values, noise = RNG.normal(size=200), RNG.normal(size=200)
    assert metrics.share_better(values - 0.5, values, draws(200)) == 1.0
    assert metrics.share_better(values + noise - noise.mean(), values, draws(200)) == pytest.approx(0.5, abs=0.1)


def test_pairs_tell_methods_apart_whose_intervals_overlap():
    values = 5 * RNG.normal(size=50) ** 2
    intervals = [metrics.mean_ci95(each, draws(50)) for each in (values, values + 0.1)]
    assert intervals[0][1] > intervals[1][0]
    assert metrics.share_better(values, values + 0.1, draws(50)) == 1.0


def test_a_label_diverges_from_itself_by_nothing():
    _, q = gaussian_errors()
    summary = metrics.kl_summary(np.repeat(q, 5, axis=0), np.repeat(q, 5, axis=0), 0.01, draws(10))
    numbers = [summary[name] for name in ("mean", "median", "mean_floor0", "axis_error_deg")]
    assert numbers == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=1e-9)
    assert summary["ci95"] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_of_few_submaps_there_is_no_interval():
    _, q = gaussian_errors()
    assert metrics.kl_summary(q, 2 * q, 0.01, draws(2))["ci95"] is None


def test_the_floor_softens_the_divergence_of_tiny_labels():
    label, q = 1e-5 * np.eye(2)[None], 1e-2 * np.eye(2)[None]
    summary = metrics.kl_summary(label, q, 0.01, draws(1))
    assert summary["mean"] < 0.2 < summary["mean_floor0"]


def along(*degrees: float, ratio: float = 9.0) -> np.ndarray:
    """Return covariances whose major axes lie at these angles."""
    turn = np.deg2rad(degrees)
    R = np.stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)], -1).reshape(-1, 2, 2)
    return R @ np.diag([ratio, 1.0]) @ np.swapaxes(R, 1, 2)


@pytest.mark.parametrize(
    ("label", "q", "error"), [(0, 30, 30), (170, 10, 20), (0, 90, 90), (45, -45, 90), (10, 190, 0)]
)
def test_an_axis_has_no_direction_and_errs_by_90_degrees_at_most(label: float, q: float, error: float):
    assert np.rad2deg(metrics.axis_error(along(label), along(q, ratio=2.0))) == pytest.approx(error, abs=1e-5)


def test_the_axis_error_weighs_a_drawn_out_label_more_and_a_round_one_not_at_all():
    labels = np.concatenate([along(0, ratio=3.0), along(0, ratio=1.0)])
    assert metrics.axis_error(labels, along(20, 80)) == pytest.approx(np.deg2rad(20))
    drawn_out = np.concatenate([along(0, ratio=99.0), along(0, ratio=3.0)])
    assert np.rad2deg(metrics.axis_error(drawn_out, along(0, 90))) == pytest.approx(90 * 0.5 / (0.98 + 0.5))


def test_a_round_estimate_errs_as_much_as_a_guess():
    assert np.rad2deg(metrics.axis_error(along(0, 10, 77), np.tile(2 * np.eye(2), (3, 1, 1)))) == pytest.approx(45)


def test_the_axis_of_a_pose_s_covariance_is_that_of_its_position():
    labels, q = (np.tile(np.diag([0.0, 0.0, 50.0]), (2, 1, 1)) for _ in range(2))
    labels[:, :2, :2], q[:, :2, :2] = along(0, 5), along(15, 20)
    assert np.rad2deg(metrics.axis_error(labels, q)) == pytest.approx(15)
