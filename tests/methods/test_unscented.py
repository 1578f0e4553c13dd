"""Truths of the unscented covariance: exact where registration is linear, and what it sees on flat ground."""

import numpy as np
import pytest

from pointnetkl.methods.closed_forms import censi, unscented
from toy_submaps import BOTH, SETUP, assert_turns, submap


@pytest.mark.parametrize("prior", [np.diag([9.0, 9.0]), np.diag([9.0, 4.0, 0.01])])
def test_it_is_exact_for_a_linear_registration(prior):
    J = np.random.default_rng(1).normal(size=prior.shape)
    errors = unscented.sigma_points(prior) @ J.T
    np.testing.assert_allclose(unscented.spread(errors), J @ prior @ J.T)


def test_an_error_common_to_all_starts_is_left_to_the_sandwich():
    errors = unscented.sigma_points(np.eye(2))
    np.testing.assert_allclose(unscented.spread(errors + np.array([1.0, -2.0])), unscented.spread(errors))


def test_a_start_in_the_middle_that_ends_elsewhere_counts_twice():
    errors = np.zeros((5, 2))
    errors[0] = [1, 0]
    np.testing.assert_allclose(unscented.spread(errors), np.diag([2.0, 0.0]))


def test_flat_ground_gets_the_prior():
    q = unscented.Unscented(SETUP).covariance(submap("flat"))
    # nearest neighbours lie at random, and pull a noisy copy a little way back
    np.testing.assert_allclose(q, SETUP.prior(), atol=0.35 * 9)


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_where_every_start_ends_in_the_same_place_only_the_sandwich_is_left(dof):
    whole = submap("rugged")
    q, least = unscented.Unscented(BOTH[dof]).covariance(whole), censi.Censi(BOTH[dof]).covariance(whole)
    root = np.linalg.inv(np.linalg.cholesky(least))
    np.testing.assert_allclose(root @ q @ root.T, np.eye(len(q)), atol=0.3)


def test_along_a_ridge_it_keeps_the_prior_and_across_it_does_not():
    q = unscented.Unscented(SETUP).covariance(submap("ridge"))
    assert q[0, 0] > 3
    assert q[1, 1] < 0.05


@pytest.mark.parametrize("kind", ["rugged", "flat"])
def test_it_turns_with_the_submap_by_quarters(kind):
    # by other angles the starts lie elsewhere
    assert_turns(unscented.Unscented(SETUP), kind, np.pi / 2, 0.25)
