"""Truths of the Hessian's covariance: the scale of least squares, against Monte Carlo on a toy where it holds."""

import dataclasses

import numpy as np
import pytest

from pointnetkl.methods.closed_forms import hessian, self_registration
from pointnetkl.registration import gicp
from toy_submaps import BOTH, assert_turns, submap


def linear(dimensions: int, rng: np.random.Generator, n: int = 60) -> gicp.Linearised:
    """Return matches that measure along their normals alone, as the closed form takes it."""
    normals = rng.normal(size=(n, 3))
    weights = rng.uniform(1, 9, n)[:, None, None] * normals[:, :, None] * normals[:, None]
    A = np.zeros((n, 3, 3))
    A[:, 0, 0] = A[:, 1, 1] = 1
    A[:, :2, 2] = rng.uniform(-5, 5, (n, 2))
    return gicp.Linearised(A[:, :, :dimensions], weights, np.zeros((n, 3)), np.arange(n))


@pytest.mark.parametrize("dimensions", [2, 3])
def test_it_is_the_covariance_of_least_squares_where_weights_are_right_up_to_a_scale(dimensions):
    rng = np.random.default_rng(1)
    problem = linear(dimensions, rng)
    H, gains = problem.information, problem.gains
    scale, errors, stated = 2.5, [], []
    # residuals along each normal with the variance that its weight says, times the scale
    norms = np.sqrt(np.einsum("nii->n", problem.weights))
    normals = np.linalg.eigh(problem.weights)[1][:, :, 2]
    for _ in range(6000):
        noise = (np.sqrt(scale) * rng.normal(size=len(norms)) / norms)[:, None] * normals
        motion = np.linalg.solve(H, np.einsum("nij,nj->i", gains, noise))
        errors.append(motion)
        stated.append(hessian.covariance_at(dataclasses.replace(problem, residuals=noise - problem.jacobian @ motion)))
    root = np.linalg.inv(np.linalg.cholesky(np.mean(stated, axis=0)))
    np.testing.assert_allclose(np.linalg.eigvalsh(root @ np.cov(np.transpose(errors)) @ root.T), 1, atol=0.05)


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_it_turns_with_the_submap(dof):
    assert_turns(hessian.Hessian(BOTH[dof]), "rugged", 0.7, 0.2)


def test_it_shrinks_on_rugged_ground():
    method = hessian.Hessian(BOTH["xy"])
    q = [method.covariance(submap(kind)) for kind in ("flat", "mild", "rugged")]
    assert np.trace(q[0]) > 2 * np.trace(q[1]) > 4 * np.trace(q[2])


def test_it_is_the_same_each_time_and_another_with_another_seed():
    method, whole = hessian.Hessian(BOTH["xy"]), submap("rugged")
    np.testing.assert_array_equal(method.covariance(whole), method.covariance(whole))
    other = hessian.Hessian(dataclasses.replace(BOTH["xy"], seed=6))
    assert not np.array_equal(method.covariance(whole), other.covariance(whole))


def test_a_copy_without_noise_is_refused():
    silent = dataclasses.replace(BOTH["xy"], label=dataclasses.replace(BOTH["xy"].label, noise_sigma_m=0.0))
    with pytest.raises(self_registration.SelfRegistrationError, match=r"toy, submap 0.*label\.noise_sigma_m is 0"):
        hessian.Hessian(silent).covariance(submap("flat"))


def test_with_split_copies_it_looks_at_two_passes_over_the_ground():
    setup = dataclasses.replace(
        BOTH["xy"], label=dataclasses.replace(BOTH["xy"].label, copy="split", noise_sigma_m=1e-6)
    )
    same = dataclasses.replace(setup, label=dataclasses.replace(setup.label, copy="same"))
    split, same_copy = (np.trace(hessian.Hessian(setup).covariance(submap("rugged"))) for setup in (setup, same))
    assert split > 1e3 * same_copy  # the very points fit without a misfit
