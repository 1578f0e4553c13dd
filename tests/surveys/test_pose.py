"""Frames: from the submap to the map and back, and headings as yaws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from pointnetkl.surveys import pose

angles = st.floats(-10.0, 10.0)
metres = st.floats(-1e6, 1e6)
few = hypothesis_settings(max_examples=50, deadline=None)


@few
@given(metres, metres, metres, angles)
def test_a_point_goes_to_the_map_and_back(x: float, y: float, z: float, yaw: float):
    T_map_submap = pose.matrix(np.array([x, y, z]), yaw)
    points = np.random.default_rng(0).uniform(-100, 100, (10, 3))
    back = pose.transform(np.linalg.inv(T_map_submap), pose.transform(T_map_submap, points))
    assert back == pytest.approx(points, abs=1e-8)


@few
@given(metres, angles, angles)
def test_transforms_chain_from_right_to_left(x: float, first: float, second: float):
    T_map_a, T_a_b = pose.matrix(np.array([x, 1.0, 2.0]), first), pose.matrix(np.array([3.0, x, 4.0]), second)
    points = np.eye(3)
    expected = pose.transform(T_map_a, pose.transform(T_a_b, points))
    assert pose.transform(T_map_a @ T_a_b, points) == pytest.approx(expected, rel=1e-9, abs=1e-6)
    assert np.exp(1j * pose.yaw_of(T_map_a @ T_a_b)) == pytest.approx(np.exp(1j * (first + second)))


def test_the_frame_is_levelled_and_looks_along_its_yaw():
    T_map_submap = pose.matrix(np.array([10.0, 20.0, -5.0]), np.pi / 2)
    ahead, port, up = pose.transform(T_map_submap, np.eye(3)) - [10.0, 20.0, -5.0]
    assert ahead == pytest.approx([0, 1, 0])
    assert port == pytest.approx([-1, 0, 0])
    assert up == pytest.approx([0, 0, 1])


def test_headings_turn_the_other_way_from_north():
    north, east, south, west = pose.heading_to_yaw(np.array([0, np.pi / 2, np.pi, 3 * np.pi / 2]))
    assert (north, east) == pytest.approx((np.pi / 2, 0.0))
    assert (south, abs(west)) == pytest.approx((-np.pi / 2, np.pi))
