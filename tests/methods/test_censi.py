"""Truths of Censi's covariance: against Monte Carlo with fixed matches, for one noisy cloud and for two."""

import dataclasses

import numpy as np
import pytest

from pointnetkl.methods.closed_forms import censi
from pointnetkl.registration import gicp
from toy_submaps import BOTH, LABEL, SETUP, assert_turns, submap

DRAWS = 6000  # 1.8 % on a variance


def pair(dof: str, kind: str = "rugged") -> tuple[gicp.Linearised, np.ndarray, np.ndarray]:
    """Return a registration at its solution, and both clouds' points (m, 3), (n, 3) as they lie there.

    Their origin is the target's centre, and the translation of the registration is taken from the target.
    """
    settings = dataclasses.replace(BOTH[dof].registration, tolerance_m=1e-6)
    target, source = (gicp.prepare(submap(kind, number, 300).points, settings) for number in (0, 1))
    registered = gicp.register(source, target, settings)
    normals = source.normals.astype(float)
    solution = gicp.linearise(source.points, normals, target, registered.T_target_source, settings)
    assert len(np.unique(solution.matches)) < len(solution.matches) == len(source.points)
    fixed = target.points - target.centre - [*registered.T_target_source.translation, 0]
    return solution, fixed[solution.matches] - solution.residuals, fixed


def solved(solution: gicp.Linearised, points: np.ndarray, matched: np.ndarray, dimensions: int) -> np.ndarray:
    """Return the motion (M,) with the least weighted squares, matches and weights as they are, yaw not made linear."""
    motion = np.zeros(3)
    for _ in range(3):
        c, s = np.cos(motion[2]), np.sin(motion[2])
        arms = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
        residuals = matched - arms - [motion[0], motion[1], 0]
        A = np.zeros((len(points), 3, 3))
        A[:, 0, 0] = A[:, 1, 1] = 1
        A[:, 0, 2], A[:, 1, 2] = -arms[:, 1], arms[:, 0]
        A = A[:, :, :dimensions]
        AM = np.swapaxes(A, 1, 2) @ solution.weights
        step = np.linalg.solve((AM @ A).sum(axis=0), np.einsum("nij,nj->i", AM, residuals))
        motion[:dimensions] += step
    return motion[:dimensions]


@pytest.mark.parametrize("target_sigma_m", [0.0, 0.1])
@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_the_sandwich_is_what_noise_does_at_fixed_matches(dof, target_sigma_m):
    solution, points, target = pair(dof)
    dimensions, rng = BOTH[dof].registration.dimensions, np.random.default_rng(1)
    solutions = np.empty((DRAWS, dimensions))
    for draw in solutions:
        noisy = points + 0.05 * rng.normal(size=points.shape)
        shaken = target + target_sigma_m * rng.normal(size=target.shape)
        draw[:] = solved(solution, noisy, shaken[solution.matches], dimensions)
    expected = np.cov(solutions.T)
    q = censi.sandwich(solution, 0.05, target_sigma_m)
    root = np.linalg.inv(np.linalg.cholesky(expected))
    np.testing.assert_allclose(np.linalg.eigvalsh(root @ q @ root.T), 1, atol=0.05)


def test_a_target_s_point_with_two_matches_counts_for_more_than_two_points_with_one():
    solution, *_ = pair("xy")
    apart = dataclasses.replace(solution, matches=np.arange(len(solution.matches)))
    shared, alone = (np.trace(censi.sandwich(each, 0.0, 0.1)) for each in (solution, apart))
    assert shared > 1.2 * alone
    np.testing.assert_allclose(censi.sandwich(apart, 0.0, 0.1), censi.sandwich(solution, 0.1))


def test_twice_the_noise_is_four_times_the_covariance():
    solution, *_ = pair("xy")
    np.testing.assert_allclose(censi.sandwich(solution, 0.2), 4 * censi.sandwich(solution, 0.1))


def test_it_is_largest_along_a_ridge():
    # without a noisy copy, whose normals find slopes where there are none
    q = censi.sandwich(pair("xy", "ridge")[0].along_normals, 0.1)
    assert q[0, 0] > 20 * q[1, 1]


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_it_turns_with_the_submap(dof):
    assert_turns(censi.Censi(BOTH[dof]), "rugged", 0.7, 0.2)


def test_it_is_far_too_sure_of_flat_ground():
    q = censi.Censi(SETUP).covariance(submap("flat"))
    assert np.trace(q) < 1e-3 * LABEL.prior_variance_m2
