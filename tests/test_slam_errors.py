"""What a solution is judged by: errors that a move of the whole map changes, and errors that it does not."""

import dataclasses

import numpy as np
import pytest

from pointnetkl import pose
from pointnetkl.slam import slam_errors
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
    found = slam_errors.errors(GRAPH, EDGES, sunk)
    assert (found["rmse_se2_m"], found["rmse_4dof_m"]) == (pytest.approx(3.0), pytest.approx(0.0, abs=1e-9))


def test_the_error_of_pairs_is_that_of_their_relative_position():
    shifted = GRAPH.truth.copy()
    source = int(EDGES.source[0])
    shifted[source, 0, 3] += 2.0
    touched = np.isin(EDGES.source, source) ^ np.isin(EDGES.target, source)
    expected = np.sqrt(4.0 * touched.mean())
    assert slam_errors.relative_error(EDGES, shifted, GRAPH.truth) == pytest.approx(expected)


def test_without_truth_or_pairs_nothing_is_known():
    unknown = dataclasses.replace(GRAPH, truth=np.full_like(GRAPH.truth, np.nan))
    found = slam_errors.errors(unknown, EDGES, BENT)
    assert all(np.isnan(value) == name.startswith("truth_") for name, value in found.items())
    none = dataclasses.replace(EDGES, target=EDGES.target[:0], source=EDGES.source[:0], measured=EDGES.measured[:0])
    assert np.isnan(slam_errors.relative_error(none, BENT, GRAPH.truth))


def test_pose_nees_is_one_where_the_covariances_are_right():
    rng, n = np.random.default_rng(1), 5000
    A = rng.normal(size=(n, 2, 2))
    q = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(2)
    reference, poses = np.tile(np.eye(4), (2, n, 1, 1))
    poses[:, :2, 3] = np.einsum("nij,nj->ni", np.linalg.cholesky(q), rng.normal(size=(n, 2)))
    assert slam_errors.pose_nees(q, poses, reference) == pytest.approx(1.0, abs=0.06)
    assert slam_errors.pose_nees(4 * q, poses, reference) == pytest.approx(0.25, abs=0.015)


def test_the_held_first_submap_does_not_count():
    q, reference = np.tile(np.eye(2), (3, 1, 1)), np.tile(np.eye(4), (3, 1, 1))
    poses = reference.copy()
    poses[0, 0, 3] = 100.0
    assert slam_errors.pose_nees(q, poses, reference) == 0.0
