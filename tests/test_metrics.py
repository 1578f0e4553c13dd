"""Measures: their invariances, and what they say of errors whose distribution is known."""

import numpy as np
import pytest

from pointnetkl import metrics

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


def test_the_interval_of_a_mean_holds_the_mean_and_narrows_with_more_values():
    values = RNG.normal(size=400)
    low, high = metrics.mean_ci95(values, np.random.default_rng(1))
    few = metrics.mean_ci95(values[:40], np.random.default_rng(1))
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert few[1] - few[0] > high - low


def test_an_interval_of_nothing_is_refused():
    with pytest.raises(metrics.MetricsError):
        metrics.mean_ci95(np.empty(0), RNG)


def test_a_label_diverges_from_itself_by_nothing():
    _, q = gaussian_errors()
    summary = metrics.kl_summary(q, q, 0.01, np.random.default_rng(0))
    assert [summary["mean"], summary["median"], summary["mean_floor0"]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert summary["ci95"] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_the_floor_softens_the_divergence_of_tiny_labels():
    label, q = 1e-5 * np.eye(2)[None], 1e-2 * np.eye(2)[None]
    summary = metrics.kl_summary(label, q, 0.01, np.random.default_rng(0))
    assert summary["mean"] < 0.2 < summary["mean_floor0"]
