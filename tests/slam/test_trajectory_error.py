"""Errors of trajectories: their invariances, and what alignment takes away."""

import numpy as np
import pytest

from pointnetkl.slam.graph import trajectory_error

RNG = np.random.default_rng(0)
TRACK = np.cumsum(RNG.normal(size=(50, 3)), axis=0)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def test_rmse_of_a_uniform_offset_is_its_length():
    assert trajectory_error.rmse(TRACK + np.array([3.0, 4.0, 12.0]), TRACK) == pytest.approx(13.0)


def test_rmse_is_unchanged_when_both_trajectories_move_together():
    other = TRACK + RNG.normal(size=TRACK.shape)
    moved = trajectory_error.rmse(turned(other, 0.7) + 5.0, turned(TRACK, 0.7) + 5.0)
    assert moved == pytest.approx(trajectory_error.rmse(other, TRACK))


def test_rmse_to_an_unknown_truth_is_not_a_number():
    assert np.isnan(trajectory_error.rmse(TRACK, np.full_like(TRACK, np.nan)))


@pytest.mark.parametrize("angle", [-3.0, 0.0, 0.4, 2.5])
def test_alignment_undoes_a_turn_and_a_move_in_the_plane_and_leaves_depth_alone(angle: float):
    moved = turned(TRACK, angle) + np.array([100.0, -20.0, 3.0])
    assert trajectory_error.align_se2(moved, TRACK) == pytest.approx(TRACK + np.array([0.0, 0.0, 3.0]))


def test_alignment_never_makes_the_error_larger():
    other = TRACK + RNG.normal(size=TRACK.shape)
    assert trajectory_error.rmse(trajectory_error.align_se2(other, TRACK), TRACK) <= trajectory_error.rmse(other, TRACK)
