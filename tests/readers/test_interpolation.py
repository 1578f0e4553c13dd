"""Values between two samples are interpolated, angles along the shorter arc; without a near sample there are none."""

import numpy as np

from pointnetkl.readers.formats import interpolation

TIME = np.array([0.0, 1.0, 2.0, 10.0])


def test_values_lie_between_their_neighbours():
    values_at = interpolation.linear(np.array([0.0, 0.25, 2.0]), TIME, np.array([4.0, 8.0, 6.0, 0.0]), 1.5)
    np.testing.assert_allclose(values_at, [4.0, 5.0, 6.0])


def test_in_a_gap_and_far_beyond_the_ends_there_is_nothing():
    asked = np.array([-0.5, -2.0, 5.0, 10.0, 10.5, 12.0])
    values_at = interpolation.linear(asked, TIME, TIME, 1.5)
    np.testing.assert_array_equal(values_at, [0.0, np.nan, np.nan, 10.0, 10.0, np.nan])


def test_samples_in_any_order_and_without_a_value_do_no_harm():
    order = [3, 1, 0, 2]
    values = np.array([0.0, np.nan, 2.0, 10.0])
    values_at = interpolation.linear(np.array([1.0]), TIME[order], values[order], 3.0)
    np.testing.assert_allclose(values_at, [1.0])
    assert np.isnan(interpolation.linear(np.array([1.0]), np.empty(0), np.empty(0), 3.0)).all()
    np.testing.assert_allclose(interpolation.linear(np.array([1.0]), np.ones(3), np.array([7.0, 8.0, 9.0]), 3.0), [7.0])


def test_headings_and_longitudes_go_the_short_way_round():
    heading = interpolation.angle(np.array([0.5]), TIME[:2], np.deg2rad([350.0, 20.0]), 2.0)
    np.testing.assert_allclose(np.rad2deg(heading), [5.0])
    longitude = interpolation.longitude(np.array([0.5]), TIME[:2], np.array([179.9999, -179.9997]), 2.0)
    np.testing.assert_allclose(longitude, [-179.9999], rtol=0, atol=1e-10)
