"""Robust estimators: what they take for true, and what they make of a closure that is not."""

import dataclasses

import numpy as np
import pytest

from pointnetkl.slam.graph import gtsam_search, pose_graph, trajectory_error
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.robust import estimators, schemas
from pointnetkl.surveys import pose
from toy_survey import CLOSURE, DEAD_RECKONING

THRESHOLDS = estimators.Thresholds(1.345, 1.0, 1.0, 0.99, 2.0)
SQUARE = np.array(  # sailed twice, the second time over the same ground
    [pose.matrix(np.array([x, y, -20.0]), 0.0) for x, y in [(0.0, 0.0), (100, 0), (100, 100), (0, 100)] * 3]
)
TRUE = [(k, k + 4) for k in range(8)]


def closures(false: int) -> Edges:
    """Return the true closures, then so many that say that opposite corners are one."""
    pairs = np.array(TRUE + [(k, k + 2) for k in range(false)])
    measured = np.linalg.inv(SQUARE[pairs[:, 0]]) @ SQUARE[pairs[:, 1]]
    measured[len(TRUE) :, :3, 3] = 0.0
    return Edges(pairs[:, 0], pairs[:, 1], measured)


def robust_graph(edges: Edges, q: np.ndarray, odometry: pose_graph.Odometry) -> estimators.RobustGraph:
    """Return the graph whose first corner is held, with closures of Q (e, 2, 2)."""
    sure = gtsam_search.join(gtsam_search.hold({0: SQUARE[0]}), odometry.factors)
    full = pose_graph.closure_covariances(q, CLOSURE)
    return estimators.RobustGraph(sure, odometry.initial, edges, full, THRESHOLDS)


def solve(kernel: str, false: int, sigma: float = 0.1, yaw: float = 0.005) -> estimators.Solution:
    """Return what a kernel finds from where Cauchy ends, with Q of so many metres, and dead reckoning that turns."""
    edges = closures(false)
    turns = [pose.matrix(np.zeros(3), angle) for angle in np.random.default_rng(0).normal(0, yaw, len(SQUARE) - 1)]
    dead_reckoning = pose_graph.between(SQUARE) @ np.array(turns)
    odometry = pose_graph.Odometry(dead_reckoning, DEAD_RECKONING, pose_graph.chain(SQUARE[0], dead_reckoning))
    q = np.tile(sigma**2 * np.eye(2), (len(edges.source), 1, 1))
    graph = robust_graph(edges, q, odometry)
    return graph.solve(kernel, None if kernel in ("plain", schemas.FIRST) else graph.solve(schemas.FIRST))


def error(solution: estimators.Solution) -> float:
    """Return the error of a solution's positions, metres."""
    return trajectory_error.rmse(solution.poses[:, :3, 3], SQUARE[:, :3, 3])


@pytest.mark.parametrize("kernel", ["cauchy", "dcs", "gnc"])
def test_false_closures_are_let_go_of_and_true_ones_kept(kernel: str):
    solution = solve(kernel, false=4)
    assert (solution.weights[: len(TRUE)] > estimators.ACCEPTED).all()
    assert (solution.weights[len(TRUE) :] < 0.01).all()
    assert error(solution) < 0.2 * error(solve("plain", false=4))


def test_huber_never_lets_go_of_a_closure_though_it_pulls_less():
    assert error(solve("plain", false=2)) > error(solve("huber", false=2)) > 2 * error(solve("gnc", false=2))


def test_gnc_with_nothing_but_true_closures_is_the_plain_optimiser():
    assert solve("gnc", false=0).poses == pytest.approx(solve("plain", false=0).poses, abs=1e-3)
    assert (solve("gnc", false=0).weights == 1).all()


def test_gnc_with_false_closures_finds_what_the_true_ones_alone_give():
    assert solve("gnc", false=4).poses == pytest.approx(solve("plain", false=0).poses, abs=1e-2)


def test_a_q_that_is_too_small_makes_true_closures_look_wrong():
    edges = closures(0)
    edges.T_target_source[:, :2, 3] += np.random.default_rng(1).normal(0, 0.3, (len(TRUE), 2))
    tight = dataclasses.replace(DEAD_RECKONING, x_m=0.1, y_m=0.1)  # or the poses would give way to the closures
    odometry = pose_graph.Odometry(pose_graph.between(SQUARE), tight, SQUARE)

    def believed(variance: float) -> int:
        graph = robust_graph(edges, np.tile(variance * np.eye(2), (len(TRUE), 1, 1)), odometry)
        return int((graph.solve("dcs", graph.solve("cauchy")).weights > estimators.ACCEPTED).sum())

    assert believed(0.3**2) > believed(0.03**2)


def test_a_graph_that_is_not_finite_is_an_error_and_not_an_answer():
    edges = closures(0)
    edges.T_target_source[0, 0, 3] = np.nan
    odometry = pose_graph.Odometry(pose_graph.between(SQUARE), DEAD_RECKONING, SQUARE)
    graph = robust_graph(edges, np.tile(np.eye(2), (len(TRUE), 1, 1)), odometry)
    with pytest.raises(estimators.RobustError, match="12 nodes"):
        graph.solve("plain")


@pytest.mark.parametrize(
    ("name", "value"), [("huber", 0.0), ("dcs", -1.0), ("gnc_probability", 1.0), ("gnc_step", 1.0)]
)
def test_thresholds_that_make_no_sense_are_refused(name: str, value: float):
    with pytest.raises(ValueError, match=f"^{name} is"):
        dataclasses.replace(THRESHOLDS, **{name: value})
