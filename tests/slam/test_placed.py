"""Placed registrations and their covariances: rivals against Monte Carlo, closed forms and plain loops."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import pairs
import terrains
import toy_survey
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import catalogue
from pointnetkl.slam.closures import drpm, misfit_region, placed
from pointnetkl.slam.closures import errors as closure_errors
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2
from pointnetkl.surveys.submap import Submap

SIGMA_M = 3.0
STEP_M = 3 * SIGMA_M / 30
EDGE_M2 = np.mean((STEP_M * np.arange(-30, 31)) ** 2) + STEP_M**2 / 12  # of a grid that the region fills


@pytest.fixture(scope="module")
def measured() -> closure_errors.Measured:
    """The tables of the toy survey."""
    submaps, graph = toy_survey.graph()
    label = monte_carlo.Settings(2, "same", 1.0, 0.02, 0)
    setup = closure_errors.Setup(toy_survey.SPACING, toy_survey.SETTINGS, label, toy_survey.REGISTRATION, pairs.NUMBERS)
    return closure_errors.measure(graph, submaps, closure_errors.Settings(5, 4), setup)


def relief(points: np.ndarray, spacing_m: float = 1.0) -> misfit_region.Relief:
    """Return the relief of points (n, 3), looked up everywhere."""
    cloud = gicp.prepare(points, pairs.GICP)
    box = (points[:, :2].min(axis=0), points[:, :2].max(axis=0))
    return misfit_region.relief(cloud.points, cloud.normals, box, spacing_m, SIGMA_M)


def square(size_m: float, spacing_m: float, height: np.ndarray | None = None) -> np.ndarray:
    """Return points (n, 3) of a square about the origin, at height 0 or at the plane with this slope (2,)."""
    axis = np.arange(-size_m / 2, size_m / 2 + spacing_m / 2, spacing_m)
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    return np.column_stack([xy, np.zeros(len(xy)) if height is None else xy @ height])


def test_the_misfit_is_that_of_plain_loops_over_offsets():
    target = relief(pairs.points("hills", 0, noise_m=0.0), pairs.SPACING_M)
    source = pairs.points("hills", 1)
    source = source[np.abs(source[:, :2]).max(axis=1) < 40]
    source = source[:: -(-len(source) // 500)]
    misfit = misfit_region.misfits(source, target)
    for column, row in ((0, 0), (10, 45), (30, 30), (60, 20)):
        at = source[:, :2] + (np.array([column, row]) - 30) * STEP_M
        expected = np.mean((4 * terrains.height("mild", at / 4) - source[:, 2]) ** 2)
        assert misfit[column, row] == pytest.approx(expected, rel=0.15)


def test_the_region_of_a_plane_is_a_strip_as_wide_as_the_noise_says():
    slope, noise_m = 0.1, 0.1
    source = square(60, 2.0, np.array([slope, 0.0]))
    source[:, 2] += np.random.default_rng(1).normal(0, noise_m, len(source))
    q = misfit_region.covariance(source, relief(square(120, 1.0, np.array([slope, 0.0]))))
    half_m = np.sqrt(2) * noise_m / slope  # (slope x)^2 + noise^2 is three times its least there
    assert q[0, 0] == pytest.approx(half_m**2 / 3, rel=0.15)
    assert q[1, 1] == pytest.approx(EDGE_M2, rel=1e-3)


def test_without_relief_the_region_is_the_whole_grid_and_off_the_target_too():
    flat = relief(square(120, 1.0))
    noisy = square(60, 2.0) + [0, 0, 1] * np.random.default_rng(1).normal(0, 0.1, (961, 1))
    for shift in (0.0, 500.0):
        q = misfit_region.covariance(noisy + np.array([shift, 0, 0]), flat)
        assert q == pytest.approx(EDGE_M2 * np.eye(2), rel=1e-3)


def test_offsets_that_leave_most_points_over_nothing_have_no_misfit():
    misfit = misfit_region.misfits(square(20, 1.0) + np.array([58.0, 0, 0]), relief(square(120, 1.0)))
    assert np.isfinite(misfit[:30]).all()
    assert np.isnan(misfit[40:]).all()


def test_the_noise_of_normals_is_that_of_monte_carlo():
    ground, rng = pairs.points("gentle", 0, noise_m=0.0), np.random.default_rng(2)
    order = gicp.prepare(ground, pairs.GICP)
    tilts, told = [], []
    for _ in range(60):
        noisy = gicp.prepare(order.points + [0, 0, 1] * rng.normal(0, 0.3, (len(ground), 1)), pairs.GICP)
        tilts.append(noisy.normals[:, :2])
        told.append(drpm.normal_noise(noisy, 0.3)[:, :2, :2])
    inside = np.abs(order.points[:, :2]).max(axis=1) < 45
    seen = np.var(tilts, axis=0)[inside].mean(axis=0)
    assert np.mean(told, axis=0)[inside].mean(axis=0).diagonal() == pytest.approx(seen, rel=0.15)


@pytest.mark.parametrize("sigma", [0.02, 0.024, 0.03])
def test_the_probability_of_a_signal_is_that_of_monte_carlo(sigma: float):
    rng = np.random.default_rng(3)
    rows = rng.normal(0, 0.08, (400, 2))
    noise = np.tile(sigma**2 * np.eye(2), (400, 1, 1))
    drawn = sigma * rng.normal(size=(4000, 400, 2))
    seen = np.mean((2 * rows * drawn + drawn**2).sum(axis=1) < (rows**2).sum(axis=0) / 11, axis=0)
    assert drpm.signal_probability(rows, noise) == pytest.approx(seen, abs=0.03)


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_drpm_leaves_flat_ground_to_the_start_and_takes_rugged_ground_at_its_word(dof: str):
    settings, prior = pairs.SETTINGS[dof], pairs.prior(dof)
    m = len(prior)
    for kind in ("flat", "rugged"):
        source, target = pairs.clouds(kind)
        part = gicp.Part(source.points, source.normals)
        q = drpm.covariance(part, drpm.target(target, pairs.NOISE_M), SE2.identity(), prior, settings)
        if kind == "flat":
            assert q[:2, :2] == pytest.approx(prior[:2, :2], rel=0.05, abs=0.3)
            continue
        normals = target.normals.astype(np.float64)
        arms = target.points[:, :2] - target.points[:, :2].mean(axis=0)
        jacobian = np.column_stack([normals[:, :2], arms[:, 0] * normals[:, 1] - arms[:, 1] * normals[:, 0]])[:, :m]
        sigmas = np.sqrt(np.diag(q) / np.diag(np.linalg.inv(jacobian.T @ jacobian)))
        assert sigmas == pytest.approx(sigmas[0], rel=0.1)  # all axes have the residuals' one, in metres
        assert 0.1 < sigmas[0] < 1


def test_the_ends_are_those_of_the_closures_and_only_map_has_errors_of_its_own(measured: closure_errors.Measured):
    rows, ends = measured.rows, measured.ends
    columns = ["placed_error_x_m", "placed_error_y_m"]
    assert set(ends["method"]) == set(catalogue.OF_REGISTRATIONS)
    assert len(ends) == len(catalogue.OF_REGISTRATIONS) * len(rows)
    for method, own in ends.groupby("method"):
        pd.testing.assert_frame_equal(own[["draw", "submap"]].reset_index(drop=True), rows[["draw", "submap"]])
        same = own[columns].to_numpy() == rows[columns].to_numpy()
        assert same.all() if method != "map" else not same.any()


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_a_submap_whose_own_frame_is_turned_has_errors_and_covariances_that_are_turned(dof: str):
    submaps, truth = toy_survey.sail(2, 2)
    registration = dataclasses.replace(toy_survey.REGISTRATION, dof=dof)
    m, angle = registration.dimensions, 0.7
    turn = pose.matrix(np.zeros(3), angle)
    targets = [pose.transform(truth[0], submaps[0].points)]
    starts, sigmas = np.array([[0.4, -0.3, 0.01]])[:, :m], np.array([1.0, 1.0, 0.03])[:m]
    judged = []
    for R in (np.eye(4), turn):
        points = pose.transform(R, submaps[3].points)
        source = Submap("toy", 3, points, points[::2], points[1::2])
        there = placed.Placed(
            source, truth[3] @ np.linalg.inv(R), targets, toy_survey.SPACING, 2.0, registration, pairs.NUMBERS
        )
        judged.append(there.judge(there.register(starts), sigmas, 0.0)[0])
    rotation = np.eye(m)
    rotation[:2, :2] = turn[:2, :2]
    assert len(judged[0]) == len(judged[1]) == (4 if m == 2 else 3)
    for plain, turned in zip(*judged, strict=True):
        assert turned.method == plain.method
        assert turned.error == pytest.approx(rotation @ plain.error, abs=1e-5)
        assert turned.covariance == pytest.approx(rotation @ plain.covariance @ rotation.T, rel=1e-3, abs=1e-5)


def test_a_start_without_a_perturbation_has_its_covariances_all_the_same():
    submaps, truth = toy_survey.sail(2, 2)
    targets = [pose.transform(truth[0], submaps[0].points)]
    there = placed.Placed(
        submaps[3], truth[3], targets, toy_survey.SPACING, 2.0, toy_survey.REGISTRATION, pairs.NUMBERS
    )
    (judged,) = there.judge(there.register(np.zeros((1, 2))), np.zeros(2), 0.0)
    for one in judged:
        assert (np.linalg.eigvalsh(one.covariance) > 0).all()


def test_errors_of_the_pair_s_ends_are_as_large_as_q_says():
    squares = []
    for kind in ("gentle", "mild", "hills", "ridge"):
        for number in range(8):
            points = [pairs.points(kind, 2 * number + k) for k in (0, 1)]
            source = Submap("toy", number, points[0], points[0][::2], points[0][1::2])
            there = placed.Placed(
                source, np.eye(4), [points[1]], pairs.SPACING_M, None, pairs.GICP.as_gicp, pairs.NUMBERS
            )
            start = np.random.default_rng(number).normal(0, SIGMA_M, (1, 2))
            for one in there.judge(there.register(start), np.full(2, SIGMA_M), pairs.NOISE_M)[0]:
                squares.append((one.method, one.error @ np.linalg.solve(one.covariance, one.error) / 2))
    nees = pd.DataFrame(squares, columns=["method", "nees"]).groupby("method")["nees"].mean()
    assert 0.15 < nees["pair"] < 1.3  # without drift inside submaps Q is three times too large
    assert 0.15 < nees["map"] < 1.3
    assert nees["misfit_region"] < 1
