"""Pose graphs: in whose frame Q is, and what is recovered from what."""

from collections.abc import Sequence

import numpy as np
import pytest

from pointnetkl.slam.graph import pose_graph
from pointnetkl.slam.graph.pose_graph import Edges, PoseGraph
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import rotate
from toy_graphs import CROSSING, LONG_X, closure
from toy_survey import CLOSURE, DEAD_RECKONING


def moved_by(edges: Edges, q: np.ndarray) -> np.ndarray:
    """Return how far the closure moves the last node, in the map."""
    graph = PoseGraph(CROSSING[0], edges, pose_graph.closure_covariances(q[None], CLOSURE))
    optimised = graph.optimise(pose_graph.between(CROSSING), DEAD_RECKONING, CROSSING)
    return (optimised - CROSSING)[3, :2, 3]


def test_q_enters_unrotated_when_the_edge_runs_from_target_to_source():
    # Q is large along the source's x, the map's y: there the miss is not believed, across it is.
    moved = moved_by(closure(1, 3, CROSSING, (4.0, 4.0)), LONG_X)
    assert moved[0] > 2.0  # what two dead-reckoning edges of 5 m yield against a sure closure
    assert abs(moved[1]) < 0.1


def test_q_must_be_rotated_when_the_edge_runs_the_other_way():
    forward = closure(1, 3, CROSSING, (4.0, 4.0))
    backward = Edges(forward.source, forward.target, np.linalg.inv(forward.T_target_source))
    R = CROSSING[1][:2, :2].T @ CROSSING[3][:2, :2]  # turns the source's frame to the target's
    wrong, right = moved_by(backward, LONG_X), moved_by(backward, R @ LONG_X @ R.T)
    assert right == pytest.approx(moved_by(forward, LONG_X), abs=0.05)
    assert abs(wrong[0]) < 0.1 < wrong[1]


def test_the_rotation_stands_before_the_translation_in_the_covariance():
    full = pose_graph.closure_covariances(LONG_X[None], CLOSURE)[0]
    assert np.diag(full) == pytest.approx([1e-4, 1e-4, 0.0316**2, 1e4, 1e-2, 1e-4])


def test_yaw_s_covariance_moves_from_the_middle_of_the_points_to_the_frame_s_origin():
    lever, q = np.array([[20.0, -5.0]]), np.diag([0.04, 0.09, 1e-4]) + 1e-3 * np.eye(3, k=2) + 1e-3 * np.eye(3, k=-2)
    about_middle = np.random.default_rng(0).multivariate_normal(np.zeros(3), q, 20_000) / 100  # small: still linear
    x, y, yaw = about_middle.T
    at_origin = np.column_stack([x, y]) - (rotate(lever, yaw) - lever)
    full = pose_graph.closure_covariances(q[None], CLOSURE, lever)[0]
    expected = np.cov(np.column_stack([yaw, at_origin]).T) * 100**2
    assert full[2:5, 2:5] == pytest.approx(expected, rel=0.05, abs=2e-4)
    assert np.diag(full)[[0, 1, 5]] == pytest.approx([1e-4, 1e-4, 1e-4])
    untouched = pose_graph.closure_covariances(q[None], CLOSURE, np.zeros((1, 2)))[0]
    assert untouched[3:5, 3:5] == pytest.approx(q[:2, :2])
    assert untouched[2, [3, 4, 2]] == pytest.approx(q[2])


def test_a_graph_without_noise_is_recovered_from_a_wrong_start():
    edges = closure(1, 3, CROSSING, (0.0, 0.0))
    graph = PoseGraph(CROSSING[0], edges, pose_graph.closure_covariances(0.1 * np.eye(2)[None], CLOSURE))
    turns = [pose.matrix(np.zeros(3), yaw) for yaw in (0.1, -0.2, 0.1)]
    wrong = pose_graph.chain(CROSSING[0], pose_graph.between(CROSSING) @ np.array(turns))
    optimised = graph.optimise(pose_graph.between(CROSSING), DEAD_RECKONING, wrong)
    assert optimised == pytest.approx(CROSSING, abs=1e-5)


def test_dead_reckoning_along_the_relative_poses_returns_the_poses():
    assert pose_graph.chain(CROSSING[0], pose_graph.between(CROSSING)) == pytest.approx(CROSSING)


def test_without_loop_closures_the_estimate_is_dead_reckoning():
    none = Edges(np.empty(0, int), np.empty(0, int), np.empty((0, 4, 4)))
    graph = PoseGraph(CROSSING[0], none, np.empty((0, 6, 6)))
    optimised = graph.optimise(pose_graph.between(CROSSING), DEAD_RECKONING, CROSSING)
    assert optimised == pytest.approx(CROSSING, abs=1e-9)


def test_the_same_graph_has_the_same_solution_to_the_last_bit():
    edges = closure(1, 3, CROSSING, (4.0, 4.0))
    assert (moved_by(edges, LONG_X) == moved_by(edges, LONG_X)).all()


def test_better_covariances_of_the_closures_make_a_smaller_error():
    rng = np.random.default_rng(0)
    truth = np.array([pose.matrix(np.array([10.0 * (k % 6), 10.0 * (k // 6), 0.0]), 0.3 * k) for k in range(36)])
    pairs = np.array([(k, k + 6) for k in range(30)])
    a = rng.uniform(0, np.pi, 30)
    R = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]).transpose(2, 0, 1)
    sigma = np.array([0.05, 5.0])  # well known along one axis of each, hardly along the other
    q = R @ np.diag(sigma**2) @ R.transpose(0, 2, 1)
    right, blind = [], []
    for _ in range(10):
        miss = np.tile(np.eye(4), (30, 1, 1))
        miss[:, :2, 3] = np.einsum("eij,ej->ei", R, rng.normal(size=(30, 2)) * sigma)
        between = np.linalg.inv(truth[pairs[:, 0]]) @ truth[pairs[:, 1]]
        edges = Edges(pairs[:, 0], pairs[:, 1], between @ miss)
        turns = np.array([pose.matrix(np.zeros(3), yaw) for yaw in rng.normal(0, 0.03, 35)])
        noisy = pose_graph.between(truth) @ turns
        for errors, covariances in ((right, q), (blind, np.broadcast_to(q.mean(axis=0), q.shape))):
            graph = PoseGraph(truth[0], edges, pose_graph.closure_covariances(covariances, CLOSURE))
            optimised = graph.optimise(noisy, DEAD_RECKONING, pose_graph.chain(truth[0], noisy))
            errors.append(np.linalg.norm((optimised - truth)[:, :3, 3], axis=1).mean())
    assert np.mean(right) < 0.9 * np.mean(blind)


def lawnmower(rng: np.random.Generator) -> tuple[Edges, np.ndarray, pose_graph.Odometry]:
    """Return a lawnmower's loop closures, true poses and dead reckoning, which is off by 0.03 rad an edge."""
    truth = np.array([pose.matrix(np.array([80.0 * (k % 9), 40.0 * (k // 9), 0.0]), 0.3 * k) for k in range(36)])
    pairs = np.array([(k, k + 9) for k in range(27)])
    miss = np.tile(np.eye(4), (27, 1, 1))
    miss[:, :2, 3] = rng.normal(size=(27, 2))
    edges = Edges(*pairs.T, np.linalg.inv(truth[pairs[:, 0]]) @ truth[pairs[:, 1]] @ miss)
    turns = np.array([pose.matrix(np.zeros(3), yaw) for yaw in rng.normal(0, 0.03, 35)])
    noisy = pose_graph.between(truth) @ turns
    return edges, truth, pose_graph.Odometry(noisy, DEAD_RECKONING, pose_graph.chain(truth[0], noisy))


def misses(rng: np.random.Generator, sigmas: Sequence[float], count: int) -> np.ndarray:
    """Return poses (count, 4, 4) that are off by noise in yaw, x and y."""
    rows = rng.normal(0, sigmas, (count, 3))
    return np.array([pose.matrix(np.array([x, y, 0.0]), yaw) for yaw, x, y in rows])


@pytest.mark.parametrize("sigma", [1.0, 1e-3, 1e-5, 1e-7])
def test_closures_are_solved_however_sure_one_direction_is(sigma: float):
    # along one axis of each loop closure a metre, along the other sigma: Cholesky and Levenberg-Marquardt give up
    rng = np.random.default_rng(3)
    edges, truth, odometry = lawnmower(rng)
    a = rng.uniform(0, np.pi, 27)
    R = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]).transpose(2, 0, 1)
    q = R @ np.diag([1.0, sigma**2]) @ R.transpose(0, 2, 1)
    graph = PoseGraph(truth[0], edges, pose_graph.closure_covariances(q, CLOSURE))
    optimised = graph.solve(odometry)
    residual = np.linalg.inv(edges.T_target_source) @ np.linalg.inv(optimised[edges.target]) @ optimised[edges.source]
    sure = np.einsum("eij,ei->ej", R, residual[:, :2, 3])[:, 1]
    assert np.abs(sure).max() < max(4 * sigma, 0.02)  # what turns of the edges leave
    assert np.isfinite(graph.position_covariances(odometry, optimised)).all()


def test_an_answer_is_at_rest_wherever_the_search_began():
    rng = np.random.default_rng(4)
    edges, truth, odometry = lawnmower(rng)
    graph = PoseGraph(truth[0], edges, pose_graph.closure_covariances(np.tile(np.eye(2), (27, 1, 1)), CLOSURE))
    other = pose_graph.Odometry(np.empty((0, 4, 4)), DEAD_RECKONING, truth)
    other.factors = odometry.factors
    assert graph.solve(other) == pytest.approx(graph.solve(odometry), abs=1e-3)


def test_a_graph_that_has_no_minimum_is_an_error_and_not_its_start():
    edges, truth, odometry = lawnmower(np.random.default_rng(5))
    broken = np.tile(np.diag([np.nan] * 6), (27, 1, 1))
    with pytest.raises(pose_graph.PoseGraphError, match="no solution"):
        PoseGraph(truth[0], edges, broken).solve(odometry)


def test_the_claimed_position_is_what_sampling_the_noise_finds():
    rng, q = np.random.default_rng(6), np.diag([4.0, 0.25])
    edges, truth, _ = lawnmower(rng)
    between = np.linalg.inv(truth[edges.target]) @ truth[edges.source]
    full = pose_graph.closure_covariances(np.tile(q, (27, 1, 1)), CLOSURE)
    samples = []
    for _ in range(250):
        steps = pose_graph.between(truth) @ misses(rng, pose_graph.sigmas(DEAD_RECKONING)[2:5], 35)
        seen = Edges(edges.target, edges.source, between @ misses(rng, [CLOSURE.yaw_rad, 2.0, 0.5], 27))
        graph = PoseGraph(truth[0], seen, full)
        odometry = pose_graph.Odometry(steps, DEAD_RECKONING, truth)
        samples.append(graph.solve(odometry)[20, :2, 3])
    claimed = graph.position_covariances(odometry, truth)[20]
    whitened = np.linalg.solve(np.linalg.cholesky(claimed), (np.array(samples) - truth[20, :2, 3]).T)
    assert np.cov(whitened) == pytest.approx(np.eye(2), abs=0.3)


def test_covariances_by_qr_are_those_of_marginals():
    edges, truth, odometry = lawnmower(np.random.default_rng(7))
    graph = PoseGraph(truth[0], edges, pose_graph.closure_covariances(np.tile(np.eye(2), (27, 1, 1)), CLOSURE))
    usual = graph.position_covariances(odometry, truth)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pose_graph.gtsam, "Marginals", lambda *_: (_ for _ in ()).throw(RuntimeError("singular")))
        assert graph.position_covariances(odometry, truth) == pytest.approx(usual, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, -1.0, 1e-300, 1e300, np.nan])
def test_noise_that_is_not_positive_or_beyond_arithmetic_is_refused(yaw: float):
    with pytest.raises(ValueError, match=r"yaw_rad is .*, must be from 1e-09 to 1e\+06"):
        pose_graph.ClosureNoise(0.01, 0.01, yaw, 0.01)
