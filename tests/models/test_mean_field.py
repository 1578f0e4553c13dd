"""Truths of the mean field: what a registration does on average, from tables of the ground alone."""

import concurrent.futures
import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import terrains
import toy_submaps
from pointnetkl.models import mean_field
from pointnetkl.models.mean_field import Conditions, MeanFieldError
from pointnetkl.registration import monte_carlo
from pointnetkl.registration.covariance import gaussian
from pointnetkl.surveys.submap import Submap

LABEL = dataclasses.replace(toy_submaps.LABEL, noise_sigma_m=0.2)
CONDITIONS = mean_field.conditions(LABEL, toy_submaps.REGISTRATION)
PRIOR_M2 = LABEL.prior_variance_m2
SEABED = terrains.cloud("mild", 2000, size_m=150.0)


def covariance(points: np.ndarray, conditions: Conditions = CONDITIONS) -> np.ndarray:
    return mean_field.describe(points, conditions).covariance


def kl(p: np.ndarray, q: np.ndarray) -> float:
    """Return the divergence as methods are judged, with a floor of 0.01 m^2 on both sides."""
    return float(gaussian.kl_divergence(gaussian.with_floor(p, 0.01), gaussian.with_floor(q, 0.01)))


def label(points: np.ndarray, runs: int = 300) -> np.ndarray:
    """Return Monte Carlo's covariance of registrations under the same conditions."""
    submap = Submap("toy", 0, points, points, points)
    rng = np.random.default_rng(1)
    return monte_carlo.covariance(monte_carlo.errors(submap, runs, rng, LABEL, toy_submaps.REGISTRATION).errors)


@pytest.mark.parametrize("kind", ["flat", "gentle", "mild", "rugged"])
def test_it_is_what_monte_carlo_finds(kind: str):
    points = terrains.cloud(kind, 900)
    assert kl(label(points), covariance(points)) < 0.1


def test_it_is_what_monte_carlo_finds_of_yaw_too():
    for kind in ("gentle", "mild", "rugged"):
        submap = toy_submaps.submap(kind)
        errors = monte_carlo.errors(submap, 200, np.random.default_rng(1), LABEL, toy_submaps.WITH_YAW).errors
        yaw = mean_field.describe(submap.points, CONDITIONS).yaw_variance(CONDITIONS)
        assert 0.5 < yaw / monte_carlo.covariance(errors)[2, 2] < 2


def test_flat_ground_keeps_much_of_the_prior_in_every_direction():
    described = mean_field.describe(terrains.cloud("flat", 900), CONDITIONS)
    assert (np.linalg.eigvalsh(described.covariance) > 0.3 * PRIOR_M2).all()
    assert (np.linalg.eigvalsh(described.covariance) < PRIOR_M2).all()
    assert described.yaw_variance(CONDITIONS) > 0.3 * CONDITIONS.prior_yaw_sigma_rad**2


def test_points_too_far_apart_to_be_mistaken_for_each_other_find_themselves_on_flat_ground():
    assert covariance(terrains.cloud("flat", 900, size_m=600.0)).max() < 0.01 * PRIOR_M2


def test_a_ridge_holds_across_and_not_along():
    q = covariance(terrains.cloud("ridge", 900))
    assert q[1, 1] < 0.02
    assert q[0, 0] > 30 * q[1, 1]


@pytest.mark.parametrize("kind", ["flat", "mild", "rugged"])
def test_it_turns_with_the_submap(kind: str):
    points = terrains.cloud(kind, 900)
    q = covariance(points)
    for angle, most in ((np.pi / 2, 2e-3), (0.3, 0.02), (2.5, 0.02)):
        R = toy_submaps.rotation(angle, 3)
        assert kl(R[:2, :2] @ q @ R[:2, :2].T, covariance(points @ R.T)) < most


def test_where_the_submap_lies_changes_nothing():
    for away in ([1234.5, -77.7, 50.0], [0, 0, -4000]):
        np.testing.assert_allclose(covariance(SEABED + away), covariance(SEABED), rtol=0.02, atol=1e-4)


def test_the_order_of_points_changes_nothing():
    shuffled = np.random.default_rng(0).permutation(SEABED)
    np.testing.assert_allclose(covariance(shuffled), covariance(SEABED), rtol=1e-3, atol=1e-6)


def test_a_copy_without_noise_finds_its_place_on_rough_ground():
    described = mean_field.describe(SEABED, dataclasses.replace(CONDITIONS, noise_sigma_m=0.0))
    assert np.abs(described.ends).max() < 10 * CONDITIONS.tolerance_m


def test_more_noise_is_more_variance():
    sigmas = (0.0, 0.1, 0.2, 0.4, 0.8)
    variances = [np.trace(covariance(SEABED, dataclasses.replace(CONDITIONS, noise_sigma_m=s))) for s in sigmas]
    assert variances == sorted(variances)
    assert variances[-1] > 10 * variances[1]


def test_higher_ground_is_stiffer():
    low, high = (mean_field.describe(SEABED * [1, 1, h], CONDITIONS).stiffness for h in (0.2, 0.4))
    assert (np.linalg.eigvalsh(high - 2 * low) > 0).all()


def test_it_says_how_many_points_there_are_and_how_far_apart():
    described = mean_field.describe(SEABED, CONDITIONS)
    assert described.points == len(SEABED)
    assert described.spacing_m == pytest.approx(150 / np.sqrt(2000), rel=0.05)
    np.testing.assert_allclose(described.extent, np.cov(SEABED[:, :2].T, bias=True))


def test_a_hole_of_100_m_is_not_ground():
    wide = terrains.cloud("mild", 8000, size_m=300.0)
    holed = wide[np.abs(wide[:, :2]).max(axis=1) > 50]
    whole, described = mean_field.describe(wide, CONDITIONS), mean_field.describe(holed, CONDITIONS)
    assert described.spacing_m == pytest.approx(whole.spacing_m, rel=0.05)
    np.testing.assert_allclose(described.covariance, whole.covariance * len(wide) / len(holed), rtol=0.5, atol=2e-4)


@pytest.mark.parametrize("place", [[1000.0, 1000.0, 0.0], [0.0, -10_000.0, 30.0]])
def test_a_point_far_from_all_others_changes_little(place: list[float]):
    q = covariance(np.vstack([SEABED, [place]]))
    np.testing.assert_allclose(q, covariance(SEABED), rtol=0.2, atol=5e-4)


def test_an_outlier_that_would_take_gigabytes_is_refused():
    for away in ([1e4, 1e4, 0.0], [1e5, 0.0, 0.0], [1e7, 1e7, 0.0]):
        with pytest.raises(MeanFieldError, match="remove outliers"):
            covariance(np.vstack([SEABED, [away]]))


def test_points_that_come_twice_are_twice_as_many_on_the_same_ground():
    once, twice = covariance(SEABED), covariance(np.concatenate([SEABED, SEABED]))
    assert 0.3 < np.trace(twice) / np.trace(once) < 0.9


def test_one_point_that_is_repeated_is_no_ground():
    with pytest.raises(MeanFieldError, match="repeated points"):
        covariance(np.tile(SEABED[:1], (50, 1)))


def test_a_line_of_points_is_no_ground():
    with pytest.raises(MeanFieldError, match="on a line"):
        covariance(SEABED * [1, 0, 1])


def test_six_points_are_the_fewest():
    close = SEABED[np.argsort(np.hypot(SEABED[:, 0], SEABED[:, 1]))]
    gaussian.check(covariance(close[:6]), "six points")
    with pytest.raises(MeanFieldError, match="5 points, of which 5 are numbers"):
        covariance(close[:5])


def test_what_is_not_a_number_is_refused():
    for bad in (np.nan, np.inf):
        points = SEABED.copy()
        points[3, 2] = bad
        with pytest.raises(MeanFieldError, match=f"{len(SEABED)} points, of which {len(SEABED) - 1} are numbers"):
            covariance(points)


def test_float32_points_are_the_same_points():
    np.testing.assert_allclose(covariance(SEABED.astype(np.float32)), covariance(SEABED), rtol=0.02, atol=1e-4)


def test_a_steep_valley_holds_across_and_slides_along():
    walls = SEABED.copy()
    walls[:, 2] = 5 * np.abs(walls[:, 0])
    q = covariance(walls)
    assert q[0, 0] < 1e-3
    gaussian.check(q, "walls")


@pytest.mark.parametrize("spacing_m", [0.5, 1.0, 2.0, 20.0])
def test_dense_and_sparse_submaps_of_rough_ground_are_held(spacing_m: float):
    q = covariance(terrains.cloud("mild", 4000, size_m=spacing_m * np.sqrt(4000)))
    gaussian.check(q, "test")
    assert q.max() < 0.01 * PRIOR_M2


def test_threads_and_repeated_calls_give_the_same_bytes():
    submaps = [terrains.cloud("mild", 900, number) for number in range(6)]
    alone = [mean_field.describe(points, CONDITIONS).ends.tobytes() for points in submaps]
    with concurrent.futures.ThreadPoolExecutor(3) as pool:
        together = pool.map(lambda points: mean_field.describe(points, CONDITIONS).ends.tobytes(), submaps * 3)
        assert list(together) == alone * 3


SLOPES = """
import numpy as np
from pointnetkl.models.mean_field import forces, ground
{before}
rng = np.random.default_rng(0)
fields = (rng.random((4, 60, 90)).astype(np.float32) for _ in range(3))
print(forces.slopes(*fields, 2, 1, 2e-3).tobytes().hex())
"""


@pytest.mark.slow
def test_the_only_reordered_sums_are_the_same_whoever_compiled_them_and_after_what(tmp_path: Path):
    def sums(cache: str, before: str = "") -> str:
        variables = {"PYTHONPATH": str(Path(__file__).parents[2] / "src"), "NUMBA_CACHE_DIR": str(tmp_path / cache)}
        command = [sys.executable, "-c", SLOPES.format(before=before)]
        return subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=True).stdout

    compiled = sums("one")
    assert list((tmp_path / "one").rglob("*.nbc"))
    assert sums("one") == compiled
    assert sums("two", before="ground.spacing(np.eye(9, 3))") == compiled


@pytest.mark.parametrize("spacing_m", [2.2, 3.0])
def test_flat_ground_sampled_on_a_lattice_keeps_about_the_prior(spacing_m: float):
    """A copy sticks at the nearest of the lattice's own offsets; registrations give 6.5 to 9 m^2, the prior is 9."""
    side = np.arange(-50.0, 50.0, spacing_m)
    x, y = (each.ravel() for each in np.meshgrid(side, side))
    variances = np.linalg.eigvalsh(covariance(np.column_stack([x, y, np.zeros_like(x)])))
    assert np.all((variances > 0.5 * PRIOR_M2) & (variances < 1.5 * PRIOR_M2))
