"""Maps on a sheet keep their proportions and tell their scale."""

import numpy as np
import pytest

from pointnetkl.reporting.drawing import sheet


def test_a_map_is_as_high_as_it_is_wide_times_its_proportions():
    corners = np.array([[0.0, 0.0], [200.0, 300.0]])
    figure = sheet.sheet(6.0)
    box = sheet.panel(figure, 0.5, 1.0, 2.0, corners).get_position()
    wide, high = figure.get_size_inches()
    assert box.width * wide == pytest.approx(2.0)
    assert box.height * high == pytest.approx(3.0)
    assert (1 - box.y1) * high == pytest.approx(1.0)


def test_limits_hold_every_point_and_keep_within_proportions():
    points = np.array([[0.0, 0.0], [1000.0, 5.0]])
    low, high = sheet.limits(points, flattest=0.3)
    assert (low < points).all()
    assert (high > points).all()
    assert (high - low)[1] / (high - low)[0] == pytest.approx(0.3)


@pytest.mark.parametrize(("value", "rounded"), [(1.0, 1.0), (4.9, 2.0), (5.0, 5.0), (0.07, 0.05), (999.0, 500.0)])
def test_a_bar_has_a_round_length(value: float, rounded: float):
    assert sheet.round_below(value) == pytest.approx(rounded)
