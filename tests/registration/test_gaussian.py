"""The divergence of Gaussians is zero for equal ones only, and a covariance is what it must be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy import stats

from pointnetkl.registration.covariance import gaussian
from pointnetkl.registration.covariance.gaussian import CovarianceError

RNG = np.random.default_rng(0)
few = hypothesis_settings(max_examples=50, deadline=None)


@st.composite
def covariances(draw: st.DrawFn) -> np.ndarray:
    """Draw 2 x 2 covariances with standard deviations from 3 mm to 3 m, at any angle."""
    angle, s, t = draw(st.floats(0, np.pi)), draw(st.floats(-2.5, 0.5)), draw(st.floats(-2.5, 0.5))
    c, d = np.cos(angle), np.sin(angle)
    R = np.array([[c, -d], [d, c]])
    q = R @ np.diag([10 ** (2 * s), 10 ** (2 * t)]) @ R.T
    return (q + q.T) / 2


@few
@given(covariances())
def test_kl_divergence_is_zero_for_equal_covariances(p: np.ndarray):
    assert gaussian.kl_divergence(p, p) == pytest.approx(0.0, abs=1e-8)


@few
@given(covariances(), st.floats(1.1, 10.0))
def test_kl_divergence_is_positive_for_different_ones(p: np.ndarray, factor: float):
    assert gaussian.kl_divergence(p, factor * p) == pytest.approx(1 / factor - 1 + np.log(factor), abs=1e-8)
    assert gaussian.kl_divergence(p, factor * p) > 0
    assert gaussian.kl_divergence(factor * p, p) > gaussian.kl_divergence(p, factor * p)  # too small is worse


@few
@given(covariances(), covariances())
def test_kl_divergence_is_unchanged_by_a_change_of_coordinates(p: np.ndarray, q: np.ndarray):
    A = np.array([[1.2, 0.4], [-0.3, 0.7]])
    expected = gaussian.kl_divergence(p, q)
    assert expected >= -1e-8
    assert gaussian.kl_divergence(A @ p @ A.T, A @ q @ A.T) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_kl_divergence_is_the_integral_that_defines_it():
    p, q = np.array([[2.0, 0.6], [0.6, 0.5]]), np.array([[1.0, -0.2], [-0.2, 3.0]])
    axis = np.linspace(-14, 14, 801)
    xy = np.stack(np.meshgrid(axis, axis), -1)

    def log_density(s: np.ndarray) -> np.ndarray:
        inside = np.einsum("...i,ij,...j", xy, np.linalg.inv(s), xy)
        return -0.5 * inside - np.log(2 * np.pi) - 0.5 * np.log(np.linalg.det(s))

    lp, lq = log_density(p), log_density(q)
    integral = np.sum(np.exp(lp) * (lp - lq)) * (axis[1] - axis[0]) ** 2
    assert gaussian.kl_divergence(p, q) == pytest.approx(integral, rel=1e-6)


def test_kl_divergence_in_one_dimension_is_the_textbook_one():
    s, t = 0.3, 2.0
    expected = np.log(t / s) + s**2 / (2 * t**2) - 0.5
    assert gaussian.kl_divergence(np.array([[s**2]]), np.array([[t**2]])) == pytest.approx(expected)


def test_kl_divergence_of_a_stack_is_that_of_each_and_survives_tiny_covariances():
    p = np.stack([np.eye(2), 1e-200 * np.eye(2)])
    assert gaussian.kl_divergence(p, 2 * p) == pytest.approx([np.log(2) - 0.5] * 2)
    assert gaussian.kl_divergence(p[0], np.stack([p[0], 2 * p[0]])) == pytest.approx([0, np.log(2) - 0.5])


def test_the_floor_of_a_yaw_is_that_of_x_and_y_at_100_m():
    floor = gaussian.with_floor(np.zeros((3, 3)), 0.04)
    assert floor == pytest.approx(np.diag([0.2, 0.2, 0.2 / 100]) ** 2)


def test_a_floor_is_added_to_the_diagonal_only():
    q = np.array([[[1.0, 0.5], [0.5, 2.0]]])
    assert gaussian.with_floor(q, 0.01).tolist() == [[[1.01, 0.5], [0.5, 2.01]]]


@few
@given(covariances())
def test_a_covariance_passes_the_check_unchanged(q: np.ndarray):
    assert gaussian.check(q, "here") is q


def test_rounding_far_below_the_variances_is_no_lack_of_symmetry():
    q = np.array([[9.0, 1e-17], [3e-17, 9.0]])
    assert gaussian.check(q, "here") is q


@pytest.mark.parametrize(
    ("q", "message"),
    [
        ([[1.0, 2.0], [2.0, 1.0]], "here: smallest eigenvalue of the covariance is -1 m"),
        ([[1.0, 1.0], [1.0, 1.0]], "here: smallest eigenvalue"),
        ([[0.0, 0.0], [0.0, 0.0]], "here: smallest eigenvalue"),
        ([[1.0, 0.1], [0.2, 1.0]], "here: the covariance is not symmetric"),
        ([[1.0, np.nan], [np.nan, 1.0]], "here: the covariance has an entry that is not a number"),
        ([[np.inf, 0.0], [0.0, 1.0]], "here: the covariance has an entry that is not a number"),
    ],
)
def test_what_is_no_covariance_is_refused(q: list[list[float]], message: str):
    with pytest.raises(CovarianceError, match=message):
        gaussian.check(np.array(q), "here")


def gaussian_errors() -> tuple[np.ndarray, np.ndarray]:
    q = np.array([[[2.0, 0.8], [0.8, 0.5]], [[0.01, 0.0], [0.0, 9.0]]])
    draws = RNG.normal(size=(2, 20_000, 2))
    return np.einsum("kij,klj->kli", np.linalg.cholesky(q), draws), q


def test_gaussian_errors_are_calibrated_under_their_own_covariance():
    result = gaussian.calibration(*gaussian_errors())
    assert result["nees"] == pytest.approx(1.0, abs=0.02)
    for percent in (50, 90, 95, 99):
        assert result[f"coverage_{percent}"] == pytest.approx(percent / 100, abs=0.01)


def test_a_covariance_four_times_too_small_has_four_times_the_nees_and_covers_less():
    errors, q = gaussian_errors()
    right, small = gaussian.calibration(errors, q), gaussian.calibration(errors, q / 4)
    assert small["nees"] == pytest.approx(4 * right["nees"])
    assert small["coverage_95"] < right["coverage_95"]


def test_calibration_is_unchanged_by_a_change_of_coordinates():
    errors, q = gaussian_errors()
    A = np.array([[2.0, 1.0], [0.3, -1.0]])
    assert gaussian.calibration(errors @ A.T, A @ q @ A.T) == pytest.approx(gaussian.calibration(errors, q))


def test_calibration_of_no_errors_is_refused():
    with pytest.raises(CovarianceError, match="cannot be judged"):
        gaussian.calibration(np.empty((0, 1, 2)), np.empty((0, 2, 2)))


def along(*degrees: float, ratio: float = 9.0) -> np.ndarray:
    """Return covariances whose major axes lie at these angles."""
    turn = np.deg2rad(degrees)
    R = np.stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)], -1).reshape(-1, 2, 2)
    return R @ np.diag([ratio, 1.0]) @ np.swapaxes(R, 1, 2)


@pytest.mark.parametrize(
    ("label", "q", "error"), [(0, 30, 30), (170, 10, 20), (0, 90, 90), (45, -45, 90), (10, 190, 0)]
)
def test_an_axis_has_no_direction_and_errs_by_90_degrees_at_most(label: float, q: float, error: float):
    assert np.rad2deg(gaussian.axis_error(along(label), along(q, ratio=2.0))) == pytest.approx(error, abs=1e-5)


def test_the_axis_error_weighs_a_drawn_out_label_more_and_a_round_one_not_at_all():
    labels = np.concatenate([along(0, ratio=3.0), along(0, ratio=1.0)])
    assert gaussian.axis_error(labels, along(20, 80)) == pytest.approx(np.deg2rad(20))
    drawn_out = np.concatenate([along(0, ratio=99.0), along(0, ratio=3.0)])
    assert np.rad2deg(gaussian.axis_error(drawn_out, along(0, 90))) == pytest.approx(90 * 0.5 / (0.98 + 0.5))


def test_a_round_estimate_errs_as_much_as_a_guess():
    assert np.rad2deg(gaussian.axis_error(along(0, 10, 77), np.tile(2 * np.eye(2), (3, 1, 1)))) == pytest.approx(45)


def test_the_axis_of_a_pose_s_covariance_is_that_of_its_position():
    labels, q = (np.tile(np.diag([0.0, 0.0, 50.0]), (2, 1, 1)) for _ in range(2))
    labels[:, :2, :2], q[:, :2, :2] = along(0, 5), along(15, 20)
    assert np.rad2deg(gaussian.axis_error(labels, q)) == pytest.approx(15)


def test_the_log_likelihood_is_the_logarithm_of_the_density():
    q = np.array([[[2.0, 0.6], [0.6, 0.5]], [[1e-4, 0.0], [0.0, 9.0]]])
    errors = RNG.normal(size=(2, 5, 2))
    expected = [stats.multivariate_normal.logpdf(e, np.zeros(2), p) for e, p in zip(errors, q, strict=True)]
    assert gaussian.log_likelihood(errors, q) == pytest.approx(np.array(expected))
