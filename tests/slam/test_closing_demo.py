"""The demo's test surveys closed from their own navigation: nearer to the truth, and as sure as they are right."""

import dataclasses

import numpy as np
import pytest

import closable
import demo_surveys
from closable import REGISTRATION
from demo_surveys import Demo
from pointnetkl.slam.closing import solving, survey
from pointnetkl.slam.closing.estimate import Estimate, from_matrices
from pointnetkl.slam.closing.survey import Closed
from pointnetkl.slam.graph import trajectory_error


@pytest.fixture(scope="module", params=["borno_8", "thwaites_11"])
def pair_of(request: pytest.FixtureRequest) -> tuple[Demo, Closed]:
    """Return a survey, and the survey closed."""
    demo = demo_surveys.sail(request.param)
    settings = survey.Settings(rounds=2)
    return demo, survey.close(demo.clouds, demo.navigation, demo.covariance, demo.spacing_m, settings, REGISTRATION)


def aligned(poses: np.ndarray, truth: np.ndarray) -> float:
    return trajectory_error.rmse(trajectory_error.align_se2(poses[:, :3, 3], truth[:, :3, 3])[:, :2], truth[:, :2, 3])


def joined(closed: Closed, poses: np.ndarray, truth: np.ndarray) -> float:
    plane, true = from_matrices(poses), from_matrices(truth)
    offsets = [closure.tie.offset(plane) - closure.tie.offset(true) for closure in closed.accepted]
    return float(np.sqrt(np.mean(np.sum(np.square(offsets), axis=1))))


def nees(estimate: Estimate, truth: np.ndarray) -> float:
    errors = (estimate.poses - from_matrices(truth))[:, :2]
    marginals = estimate.marginals[:, :2, :2]
    return float(np.mean([e @ np.linalg.solve(M, e) / 2 for e, M in zip(errors, marginals, strict=True)]))


def test_errors_are_below_half_of_navigation_s(pair_of):
    demo, closed = pair_of
    assert len(closed.accepted) > 10
    assert closable.rms(closed.poses, demo.truth) < 0.5 * closable.rms(demo.navigation, demo.truth)
    assert aligned(closed.poses, demo.truth) < 0.5 * aligned(demo.navigation, demo.truth)
    assert joined(closed, closed.poses, demo.truth) < 0.3 * joined(closed, demo.navigation, demo.truth)


def test_poses_are_no_surer_than_chance_allows(pair_of):
    """One survey has one scale error and one heading bias: its NEES is far from 1 by chance, and not by more."""
    demo, closed = pair_of
    assert 0.1 < nees(closed.estimate, demo.truth) < 6
    assert nees(closed.estimate, demo.truth) < 2 * max(nees(closed.navigation, demo.truth), 1)


def test_a_tenth_of_wrong_ends_is_refused_and_costs_what_they_would_have_told(pair_of):
    _, closed = pair_of
    found, rng = list(closed.found), np.random.default_rng(0)
    wrong = [k for k, f in enumerate(found) if f.closure is not None and f.closure.rank == 2][::10]
    for k in wrong:
        closure = found[k].closure
        angle = rng.uniform(0, 2 * np.pi)
        end = 10 * np.array([np.cos(angle), np.sin(angle)])
        found[k] = dataclasses.replace(found[k], closure=dataclasses.replace(closure, c=closure.c + closure.A @ end))
    judged, estimate = survey.judge(closed.navigation, found, survey.Settings())
    assert wrong
    assert all(judged[k].state != survey.State.ACCEPTED for k in wrong)
    kept = [f.closure for k, f in enumerate(closed.found) if f.state == survey.State.ACCEPTED and k not in wrong]
    without = solving.solve(closed.navigation, kept)
    assert np.abs(estimate.poses - without.poses)[:, :2].max() < 0.5
