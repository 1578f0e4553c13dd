"""How far the depths of passes over the same ground disagree."""

import numpy as np
import pytest

import closable
from pointnetkl.correction.solution import disagreement
from pointnetkl.surveys import pose

SPACING_M = 2.0


def carpet(height_m: float, seed: int = 0) -> np.ndarray:
    """Return level points (n, 3), one in a square of a spacing, over 60 m by 60 m."""
    rng = np.random.default_rng(seed)
    corners = np.stack(np.meshgrid(*2 * [np.arange(-30.0, 30.0, SPACING_M)]), -1).reshape(-1, 2)
    xy = corners + SPACING_M * rng.random(corners.shape)
    return np.column_stack([xy, np.full(len(xy), height_m)])


def at(*places: tuple[float, float]) -> np.ndarray:
    return np.array([pose.matrix(np.array([x, y, 0.0]), 0.0) for x, y in places])


def test_two_passes_differ_by_the_step_between_them():
    cells = disagreement.measure([carpet(-40.0), carpet(-40.3, 1)], at((0, 0), (0, 0)), np.array([0, 1]), SPACING_M)
    assert cells.difference_m == pytest.approx(np.full(len(cells.xy), 0.3))
    assert cells.rms_m == pytest.approx(0.3)
    assert len(cells.xy) == pytest.approx(400, abs=60)  # of 6 m, on four grids
    assert np.abs(cells.xy).max() < 33


def test_only_ground_that_both_have_counts():
    cells = disagreement.measure([carpet(-40.0), carpet(-41.0, 1)], at((0, 0), (30, 0)), np.array([0, 1]), SPACING_M)
    assert cells.xy[:, 0].min() > -3
    assert cells.xy[:, 0].max() < 33


def test_of_three_passes_the_shallowest_and_the_deepest_count():
    clouds = [carpet(-40.0), carpet(-40.2, 1), carpet(-40.5, 2)]
    cells = disagreement.measure(clouds, at(*3 * [(0, 0)]), np.array([4, 7, 5]), SPACING_M)
    assert cells.rms_m == pytest.approx(0.5, rel=0.03)


def test_a_pass_does_not_disagree_with_itself():
    cells = disagreement.measure([carpet(-40.0), carpet(-41.0)], at((0, 0), (0, 0)), np.array([3, 3]), SPACING_M)
    assert len(cells.xy) == 0
    assert np.isnan(cells.rms_m)


def test_passes_that_share_no_ground_have_nothing_to_disagree_on():
    cells = disagreement.measure([carpet(-40.0), carpet(-41.0)], at((0, 0), (100, 0)), np.array([0, 1]), SPACING_M)
    assert np.isnan(cells.rms_m)


def test_cells_of_too_few_points_do_not_count():
    sparse = np.array([[0.0, 0.0, -30.0], [1.0, 0.0, -30.0]])
    cells = disagreement.measure([carpet(-40.0), sparse], at((0, 0), (0, 0)), np.array([0, 1]), SPACING_M)
    assert len(cells.xy) == 0


def test_the_order_of_submaps_does_not_matter():
    toy = closable.sail("hills")
    line, order = np.repeat(np.arange(3), 4), np.arange(12)[::-1]
    poses = toy.drifted(0)
    one = disagreement.measure(toy.clouds, poses, line, SPACING_M)
    other = disagreement.measure([toy.clouds[k] for k in order], poses[order], line[order], SPACING_M)
    np.testing.assert_array_equal(one.xy, other.xy)
    np.testing.assert_allclose(one.difference_m, other.difference_m, atol=1e-9)


def test_true_poses_disagree_less_than_drifted_ones():
    toy, line = closable.sail("hills"), np.repeat(np.arange(3), 4)
    true, drifted = (disagreement.measure(toy.clouds, T, line, SPACING_M).rms_m for T in (toy.truth, toy.drifted(0)))
    assert true < 0.8 * drifted


def test_where_the_edges_of_cells_fall_hardly_matters():
    toy, line = closable.sail("hills"), np.repeat(np.arange(3), 4)
    found = []
    for shift in ([0, 0], [1, 0], [0, 2], [2, -3], [2.5, 2.5], [0.5, 0.5]):
        poses = toy.truth.copy()
        poses[:, :2, 3] += shift
        found.append(disagreement.measure(toy.clouds, poses, line, SPACING_M).rms_m)
    assert np.ptp(found) < 0.05 * np.mean(found)
