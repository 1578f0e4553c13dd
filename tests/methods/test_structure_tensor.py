"""Truths of the structure tensor's covariance, and of the fit of its four numbers."""

import dataclasses

import numpy as np
import pytest

import toy_submaps
from pointnetkl.methods.fitted import fitting
from pointnetkl.methods.fitted import structure_tensor as st
from pointnetkl.registration.covariance import gaussian
from pointnetkl.surveys.submap import Submap
from toy_submaps import SETUP, SETUP_WITH_YAW

SETTINGS = fitting.Settings(seed=4, floor_m2=0.01, starts=12)
METHOD = st.StructureTensor("structure_tensor", c=0.5, gamma=1.2, b_m2=8.0, f_m2=0.003, setup=SETUP)


def seabed(height, *, spacing=2.0, half=40.0, seed=0) -> Submap:
    """Return a submap over z = height(x, y), its points scattered about a grid."""
    axis = np.arange(-half, half, spacing)
    xy = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    xy = xy + np.random.default_rng(seed).uniform(-0.3, 0.3, xy.shape) * spacing
    points = np.column_stack([xy, height(xy[:, 0], xy[:, 1])])
    return Submap("toy", 1, points, points[::2], points[1::2])


def turned(submap: Submap, angle: float) -> tuple[Submap, np.ndarray]:
    """Return a submap turned about z by an angle, and the (2, 2) rotation."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return dataclasses.replace(submap, points=submap.points @ R.T), R[:2, :2]


def tensors(n: int = 200) -> np.ndarray:
    """Return slope tensors (n, 2, 2) over six decades, at all angles."""
    rng = np.random.default_rng(3)
    angle = rng.uniform(0, np.pi, n)
    v = np.stack([np.stack([np.cos(angle), -np.sin(angle)], -1), np.stack([np.sin(angle), np.cos(angle)], -1)], -2)
    w = 10 ** rng.uniform(-3, 3, (n, 2))
    return (v * w[:, None, :]) @ np.swapaxes(v, 1, 2)


def ridge(x, y):
    """Return the heights of ridges along y."""
    return 3 * np.sin(x / 4)


def test_it_is_small_across_a_ridge_and_large_along_it():
    q = METHOD.covariance(seabed(ridge))
    assert q[0, 0] < 0.02
    assert q[1, 1] > 10 * q[0, 0]


def test_it_rotates_with_the_submap():
    submap = seabed(lambda x, y: ridge(x, y) + 0.5 * np.cos(y / 5))
    rotated, R = turned(submap, 0.7)
    np.testing.assert_allclose(METHOD.covariance(rotated), R @ METHOD.covariance(submap) @ R.T, rtol=1e-2, atol=1e-4)


def test_it_turns_with_the_submap_where_yaw_is_found_too():
    method = dataclasses.replace(METHOD, setup=SETUP_WITH_YAW)
    submap = seabed(lambda x, y: ridge(x, y) + 0.5 * np.cos(y / 5))
    rotated, _ = turned(submap, 0.7)
    R = toy_submaps.rotation(0.7, 3)
    units = np.diag([1, 1, 100])
    expected, q = (units @ m @ units for m in (R @ method.covariance(submap) @ R.T, method.covariance(rotated)))
    np.testing.assert_allclose(q, expected, rtol=2e-2, atol=1e-4)


def test_a_ridge_and_a_mound_hold_the_yaw_differently():
    method = dataclasses.replace(METHOD, setup=SETUP_WITH_YAW)
    prior = method.setup.prior()[2, 2]
    mound = method.covariance(seabed(lambda x, y: 6 * np.exp(-(x**2 + y**2) / 200)))
    along = method.covariance(seabed(ridge))
    flat = method.covariance(seabed(lambda x, y: 0 * x))
    assert along[2, 2] < 0.01 * prior  # a turned ridge lies across the old one
    assert mound[2, 2] > 100 * along[2, 2]  # a turned mound is the same mound
    assert flat[2, 2] == pytest.approx((METHOD.b_m2 + METHOD.f_m2) / 9 * prior, rel=1e-3)


def test_flat_ground_gets_the_prior():
    q = METHOD.covariance(seabed(lambda x, y: 0 * x))
    np.testing.assert_allclose(q, (METHOD.b_m2 + METHOD.f_m2) * np.eye(2), rtol=1e-3, atol=1e-3)


def test_the_slope_tensor_of_a_tilted_plane_is_its_slope_squared_at_every_point():
    normal = np.array([-0.3, 0.1, 1.0]) / np.linalg.norm([-0.3, 0.1, 1.0])
    T = st.slope_tensor(np.tile(normal, (7, 1)))
    np.testing.assert_allclose(T, 7 * np.array([[0.09, -0.03], [-0.03, 0.01]]), atol=1e-12)


def test_a_wall_does_not_make_the_slope_tensor_infinite():
    T = st.slope_tensor(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(T, [[st.STEEPEST**2, 0], [0, 0]])


def test_the_fit_recovers_the_numbers_that_made_the_labels():
    T = tensors()
    labels = METHOD.from_tensors(T)
    fit = st.fit_tensors(T, SETUP.prior(), labels, SETTINGS)
    assert fit.mean_kl < 1e-4
    fitted = st.from_fit("structure_tensor", fit, SETUP).from_tensors(T)
    np.testing.assert_allclose(fitted, labels, rtol=0.05, atol=0.01)
    assert fit.numbers["gamma"] == pytest.approx(METHOD.gamma, rel=0.05)
    assert fit.numbers["b_m2"] == pytest.approx(METHOD.b_m2, rel=0.05)


def test_the_fit_states_the_mean_kl_of_its_own_covariances():
    T = tensors(50)
    labels = METHOD.from_tensors(T[::-1])
    fit = st.fit_tensors(T, SETUP.prior(), labels, SETTINGS)
    fitted = st.from_fit("structure_tensor", fit, SETUP).from_tensors(T)
    assert fit.mean_kl == pytest.approx(fitting.mean_kl(labels, fitted, SETTINGS.floor_m2))


def test_the_fit_beats_the_constant_on_noisy_labels():
    T = tensors()
    clean = METHOD.from_tensors(T)
    draws = np.random.default_rng(5).normal(size=(len(T), 30, 2)) @ np.swapaxes(np.linalg.cholesky(clean), 1, 2)
    labels = np.swapaxes(draws, 1, 2) @ draws / 29
    fit = st.fit_tensors(T, SETUP.prior(), labels, SETTINGS)
    assert fit.mean_kl < 0.2 * fitting.mean_kl(labels, labels.mean(axis=0), SETTINGS.floor_m2)


@pytest.mark.slow
def test_the_fit_saturates_at_the_prior_when_flat_labels_do():
    T = np.concatenate([tensors(100), np.zeros((100, 2, 2))])
    labels = dataclasses.replace(METHOD, b_m2=9.0, f_m2=1e-4).from_tensors(T)
    fitted = st.from_fit("s", st.fit_tensors(T, SETUP.prior(), labels, SETTINGS), SETUP)
    np.testing.assert_allclose(fitted.from_tensors(np.zeros((1, 2, 2)))[0], 9 * np.eye(2), rtol=0.01)


@pytest.mark.slow
def test_the_fit_is_the_same_each_time():
    T = tensors(40)
    labels = METHOD.from_tensors(T[::-1])
    assert st.fit_tensors(T, SETUP.prior(), labels, SETTINGS) == st.fit_tensors(T, SETUP.prior(), labels, SETTINGS)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e6])
def test_the_fit_answers_on_the_flattest_and_the_steepest_ground(scale):
    T = scale * tensors(20)
    fit = st.fit_tensors(T, SETUP.prior(), np.broadcast_to(np.diag([9.0, 4.0]), (20, 2, 2)), SETTINGS)
    q = st.from_fit("s", fit, SETUP).from_tensors(T)
    assert np.isfinite(fit.mean_kl)
    for matrix in q:
        gaussian.check(matrix, "test")
