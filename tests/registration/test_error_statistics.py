"""How sure a covariance is, against theory and against repetition: Gaussian errors, heavy tails, two basins."""

import numpy as np
import pytest

from pointnetkl.registration import error_statistics, monte_carlo

Q = np.array([[2.0, 0.5], [0.5, 1.0]])
TURN = np.array([[0.8, -0.6], [0.6, 0.8]])


def gaussian(runs: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).multivariate_normal([0, 0], Q, runs)


def two_basins(runs: int, share: float, offset_m: float = 5.0) -> np.ndarray:
    """Return errors of 1 cm, but for a share of them a basin apart along x."""
    sample = 0.01 * np.random.default_rng(1).standard_normal((runs, 2))
    sample[: round(share * runs), 0] += offset_m
    return sample


def test_standard_errors_are_those_of_repeated_labels():
    samples = gaussian(400 * 300).reshape(400, 300, 2)
    entries = np.stack([monte_carlo.covariance(s) for s in samples])
    claimed = np.mean([error_statistics.standard_errors(s) for s in samples], axis=0)
    assert np.allclose(entries.std(axis=0), claimed, rtol=0.1)


def test_standard_errors_of_gaussian_errors_are_those_of_theory():
    expected = np.sqrt(np.outer(np.diag(Q), np.diag(Q)) + Q**2) / np.sqrt(100_000)
    assert np.allclose(error_statistics.standard_errors(gaussian(100_000)), expected, rtol=0.02)


def test_heavy_tails_make_the_standard_error_larger():
    sample = np.random.default_rng(0).standard_t(12, (200_000, 2))
    kurtosis, variance = 3 + 6 / (12 - 4), 12 / (12 - 2)
    expected = variance * np.sqrt((kurtosis - 1) / len(sample))
    assert np.allclose(error_statistics.standard_errors(sample).diagonal(), expected, rtol=0.05)
    assert error_statistics.relative_error(sample) == pytest.approx(expected / variance, rel=0.05)


def test_the_relative_error_of_gaussian_errors_is_that_of_theory():
    assert error_statistics.relative_error(gaussian(100_000)) == pytest.approx(np.sqrt(2 / 100_000), rel=0.02)


@pytest.mark.parametrize("share", [0.3, 0.05, 0.01])
def test_the_relative_error_of_two_basins_is_that_of_counting(share: float):
    # nearly all of the variance is in how many runs are in the second basin
    error = error_statistics.relative_error(two_basins(10_000, share))
    assert error == pytest.approx(np.sqrt((1 / share - 1) / 10_000), rel=0.01)


def test_the_relative_error_is_the_same_in_every_frame():
    sample = two_basins(3000, 0.03) + gaussian(3000)
    expected = error_statistics.relative_error(sample)
    for change in (TURN, np.diag([100.0, 0.01]), np.array([[1.0, 3.0], [0.0, 0.2]])):
        assert error_statistics.relative_error(sample @ change) == pytest.approx(expected, rel=2e-3)


def test_no_direction_has_a_larger_relative_error():
    sample = two_basins(3000, 0.03) @ TURN + gaussian(3000)
    directions = np.random.default_rng(2).standard_normal((2000, 2))
    products = (sample @ directions.T) ** 2
    relative_errors = products.std(axis=0) / products.mean(axis=0) / np.sqrt(len(sample))
    assert error_statistics.relative_error(sample) == pytest.approx(relative_errors.max(), rel=2e-3)


def test_with_yaw_too_no_direction_has_a_larger_relative_error_whatever_the_units():
    rng = np.random.default_rng(5)
    sample = rng.standard_normal((3000, 3)) @ rng.standard_normal((3, 3))
    sample[:90] += 5 * rng.standard_normal(3)  # a second basin, in no axis
    directions = rng.standard_normal((20_000, 3)) @ np.linalg.inv(np.linalg.cholesky(sample.T @ sample))
    products = (sample @ directions.T) ** 2
    largest = (products.std(axis=0) / products.mean(axis=0)).max() / np.sqrt(len(sample))
    for units in ([1, 1, 1], [1, 1, 1e-3]):
        assert error_statistics.relative_error(sample * units) == pytest.approx(largest, rel=0.01)


def test_errors_in_a_plane_have_no_relative_error():
    plane = np.random.default_rng(3).standard_normal((400, 2)) @ np.array([[1.0, 0.7, 1e-3], [0.0, 2.0, 3e-3]])
    assert error_statistics.relative_error(plane) == np.inf


def test_the_main_basin_is_one_of_x_and_y_whatever_the_yaw():
    sample = two_basins(1000, 0.1) * 10
    yaw = np.random.default_rng(6).standard_cauchy(1000)
    share = error_statistics.main_basin_share(np.column_stack([sample, yaw]))
    assert share == error_statistics.main_basin_share(sample)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (1.0, 0.7), (1.0, 2.0), (1.0, 3.0)])
def test_errors_on_a_line_have_no_relative_error(direction: tuple[float, float]):
    sample = np.outer(np.random.default_rng(3).standard_normal(400), direction)
    assert error_statistics.relative_error(sample) == np.inf


@pytest.mark.parametrize(("outside", "offset_m"), [(0, 0.0), (100, 4.0), (400, 4.0)])
def test_the_main_basin_is_the_fuller_one(outside: int, offset_m: float):
    sample = 0.1 * np.random.default_rng(1).standard_normal((1000, 2)) @ [[1, 0.5], [0, 0.3]]
    sample[:outside] += offset_m
    assert error_statistics.main_basin_share(sample) == pytest.approx(1 - outside / 1000, abs=0.03)


def test_the_main_basin_of_gaussian_errors_holds_what_three_sigmas_hold():
    within = 1 - np.exp(-(3**2) / 2)  # of a chi-square of two degrees
    assert error_statistics.main_basin_share(gaussian(100_000)) == pytest.approx(within, abs=0.003)
