"""A registration linearised at its solution: matches, weights, Jacobian and the noisy copy."""

import dataclasses

import numpy as np
import pytest

from pointnetkl.registration import gicp
from pointnetkl.registration.gicp import linearised
from pointnetkl.surveys.se2 import SE2
from toy_submaps import REGISTRATION, WITH_YAW, submap

NOISE = gicp.Noise(0.1, 7)
FINE = {2: dataclasses.replace(REGISTRATION, tolerance_m=1e-6), 3: dataclasses.replace(WITH_YAW, tolerance_m=1e-6)}


def unit(n: int, seed: int) -> np.ndarray:
    """Return random unit vectors (n, 3), upwards."""
    v = np.random.default_rng(seed).normal(size=(n, 3))
    v[:, 2] = np.abs(v[:, 2])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_a_weight_is_the_inverse_of_the_two_points_covariances():
    a, b = unit(50, 1), unit(50, 2)
    c = [np.eye(3) - 0.999 * n[:, :, None] * n[:, None, :] for n in (a, b)]
    np.testing.assert_allclose(linearised.weigh(a, b, 1e-3), np.linalg.inv(c[0] + c[1]), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_gradient_vanishes_at_the_solution(dimensions):
    cloud = gicp.prepare(submap("rugged").points, FINE[dimensions])
    solution = gicp.solve(cloud, cloud, NOISE, FINE[dimensions])
    pull = np.einsum("nij,nj->i", solution.gains, solution.residuals)
    step = np.linalg.solve(solution.information, pull)
    assert np.abs(step).max() < 1e-5
    assert np.abs(np.linalg.norm(solution.residuals, axis=1)).mean() > 0.05  # there are residuals that could pull


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_information_is_the_kernel_s_own(dimensions):
    target = gicp.prepare(submap("rugged").points, FINE[dimensions])
    source = gicp.prepare(submap("rugged", 1).points, FINE[dimensions])
    result = gicp.register(source, target, FINE[dimensions])
    solution = gicp.linearise(
        source.points, source.normals.astype(float), target, result.T_target_source, FINE[dimensions]
    )
    scale = np.sqrt(np.outer(np.diag(result.information), np.diag(result.information)))
    np.testing.assert_allclose(solution.information / scale, result.information / scale, atol=1e-3)


def test_the_jacobian_says_how_points_move():
    arms, step = np.array([[3.0, -2.0, 1.0], [0.5, 4.0, 0.0]]), 1e-6
    A = linearised.jacobian(arms, 3)
    turn = np.array([[1, -step, 0], [step, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(A @ [0, 0, step], arms @ turn.T - arms, atol=1e-12)
    np.testing.assert_allclose(A @ [step, 2 * step, 0], [[step, 2 * step, 0]] * 2)


def test_a_yaw_about_another_centre_is_a_yaw_and_a_shift():
    cloud = gicp.prepare(submap("rugged").points, WITH_YAW)
    solution = gicp.solve(cloud, cloud, NOISE, WITH_YAW)
    place = np.array([5.0, -3.0, 0.0])
    moved = solution.with_centre(place).jacobian
    yaw = 0.01
    # a turn about the place takes the centre to place - R place
    shift = place[:2] - [place[0] - yaw * place[1], place[1] + yaw * place[0]]
    np.testing.assert_allclose(moved @ [0, 0, yaw], solution.jacobian @ [*shift, yaw], atol=1e-9)


def test_the_copy_is_the_one_that_is_registered():
    cloud = gicp.prepare(submap("rugged").points, FINE[2])
    points, normals = linearised.noisy_copy(cloud, cloud, NOISE)
    np.testing.assert_allclose(points - cloud.points, NOISE.draw(1, len(points))[0], atol=1e-6)
    near = points[cloud.lists]
    centred = near - near.mean(axis=1, keepdims=True)
    plane = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]
    assert np.abs((plane * normals).sum(axis=1)).min() > 0.999


def test_flat_ground_gives_no_information_along_its_normals():
    flat = submap("flat").points
    cloud = gicp.prepare(flat, REGISTRATION)
    solution = gicp.linearise(cloud.points, cloud.normals.astype(float), cloud, SE2.identity(), REGISTRATION)
    assert np.abs(solution.along_normals.information).max() < 1e-6 * len(flat)
    np.testing.assert_allclose(solution.information, 0.5 * len(flat) * np.eye(2), rtol=1e-6)


def test_points_too_far_from_the_target_are_left_out():
    cloud = gicp.prepare(submap("rugged").points, REGISTRATION)
    points = cloud.points + [0, 0, 1e3 * (np.arange(len(cloud.points)) % 2)][2][:, None] * [0, 0, 1]
    solution = gicp.linearise(points, cloud.normals.astype(float), cloud, SE2.identity(), REGISTRATION)
    assert len(solution.matches) == len(points[::2])
    np.testing.assert_allclose(solution.residuals, 0.0, atol=1e-9)
