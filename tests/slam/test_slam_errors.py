"""What a solution is judged by: errors that a move of the whole map changes, and errors that it does not."""

import dataclasses

import numpy as np
import pytest

from pointnetkl.slam.benchmark import errors as slam_errors
from pointnetkl.surveys import pose
from toy_survey import graph

_, GRAPH = graph(3, 4)
EDGES = GRAPH.closures.edges
BENT = GRAPH.gt.copy()
BENT[:, :3, 3] += np.random.default_rng(0).normal(size=(len(BENT), 3))


def test_moving_and_turning_the_whole_map_leaves_the_aligned_errors_and_those_of_pairs():
    moved = pose.matrix(np.array([30.0, -20.0, 5.0]), 0.4) @ BENT
    before, after = (slam_errors.errors(GRAPH, EDGES, poses) for poses in (BENT, moved))
    for name in ("rmse_4dof_m", "truth_rmse_4dof_m", "truth_relative_m"):
        assert after[name] == pytest.approx(before[name])
    for name in ("rmse_xyz_m", "truth_rmse_xyz_m", "rmse_se2_m"):
        assert after[name] > before[name] + 1


def test_a_map_too_deep_is_wrong_in_the_plane_s_alignment_only_by_its_depth():
    sunk = GRAPH.gt.copy()
    sunk[:, 2, 3] -= 3.0
    errors = slam_errors.errors(GRAPH, EDGES, sunk)
    assert (errors["rmse_se2_m"], errors["rmse_4dof_m"]) == (pytest.approx(3.0), pytest.approx(0.0, abs=1e-9))


def test_the_error_of_pairs_is_that_of_their_relative_position():
    shifted = GRAPH.truth.copy()
    source = int(EDGES.source[0])
    shifted[source, 0, 3] += 2.0
    touched = np.isin(EDGES.source, source) ^ np.isin(EDGES.target, source)
    expected = np.sqrt(4.0 * touched.mean())
    assert slam_errors.relative_error(EDGES, shifted, GRAPH.truth) == pytest.approx(expected)


def test_without_truth_or_pairs_nothing_is_known():
    unknown = dataclasses.replace(GRAPH, truth=np.full_like(GRAPH.truth, np.nan))
    errors = slam_errors.errors(unknown, EDGES, BENT)
    assert all(np.isnan(value) == name.startswith("truth_") for name, value in errors.items())
    none = dataclasses.replace(
        EDGES, target=EDGES.target[:0], source=EDGES.source[:0], T_target_source=EDGES.T_target_source[:0]
    )
    assert np.isnan(slam_errors.relative_error(none, BENT, GRAPH.truth))


def claims(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return covariances (n, 2, 2) and poses (n, 4, 4) that err by them, but the first, about the identity."""
    rng = np.random.default_rng(1)
    A = rng.normal(size=(count, 2, 2))
    q, poses = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(2), np.tile(np.eye(4), (count, 1, 1))
    poses[1:, :2, 3] = np.einsum("nij,nj->ni", np.linalg.cholesky(q), rng.normal(size=(count, 2)))[1:]
    return q, poses


def test_pose_nees_is_one_where_the_covariances_are_right():
    q, poses = claims(5000)
    reference = np.tile(np.eye(4), (5000, 1, 1))
    assert slam_errors.pose_nees(q, poses, reference) == pytest.approx(1.0, abs=0.06)
    assert slam_errors.pose_nees(4 * q, poses, reference) == pytest.approx(0.25, abs=0.015)


def test_a_first_submap_held_where_it_truly_is_not_tells_nothing_of_the_solution():
    q, poses = claims(200)
    reference = np.tile(np.eye(4), (200, 1, 1))
    reference[:, :2, 3] = np.random.default_rng(2).normal(0, 50, (200, 2))
    poses[:, :2, 3] += reference[:, :2, 3]
    elsewhere = pose.matrix(np.array([0.16, -3.0, 1.0]), 0.02)  # of the truth, which the graph's first pose is off
    expected = slam_errors.pose_nees(q, poses, reference)
    assert slam_errors.pose_nees(q, poses, elsewhere @ reference) == pytest.approx(expected)
    assert 0.8 < expected < 1.2


def test_one_submap_tied_to_a_held_one_does_not_make_the_number():
    q, poses = claims(200)
    reference = np.tile(np.eye(4), (200, 1, 1))
    expected = slam_errors.pose_nees(q, poses, reference)
    poses[53, 0, 3] += 0.16
    q[53] = 1e-6 * np.eye(2)
    assert slam_errors.pose_nees(q, poses, reference) == pytest.approx(expected, rel=0.05)


def test_the_held_first_submap_does_not_count():
    poses = np.tile(np.eye(4), (3, 1, 1))
    q = np.array([1e-12 * np.eye(2), np.eye(2), np.eye(2)])
    assert slam_errors.pose_nees(q, poses, pose.matrix(np.array([100.0, 0.0, 0.0]), 0.0) @ poses) == 0.0
