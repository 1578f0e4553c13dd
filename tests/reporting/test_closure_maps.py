"""Ellipses of loop closures: turned with their submap, and coloured by whether they hold the true error."""

import numpy as np
import pytest

from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.slam import closure_maps
from pointnetkl.reporting.slam.closure_maps import ClosureMap

ALONG = np.array([[9.0, 0.0], [0.0, 0.01]])  # not known along the track
SEABED = np.tile(np.linspace(50, 60, 20), (20, 1)), (0.0, 1000.0, 0.0, 1000.0)


def closures(error: np.ndarray) -> ClosureMap:
    """Registrations of as many submaps as there are errors (r, 2), whose tracks run north."""
    r = len(error)
    place = np.stack([np.linspace(100, 900, r), np.full(r, 500.0)], -1)
    q = {"network": np.tile(ALONG, (r, 1, 1)), "monte_carlo": np.tile(2 * ALONG, (r, 1, 1))}
    return ClosureMap(np.arange(r), place, np.full(r, np.pi / 2), error, q, SEABED)


def test_an_ellipse_lies_along_the_track_of_its_submap():
    east, north = closure_maps.ellipses(np.stack([ALONG, ALONG]), np.array([0.0, np.pi / 2]))
    reach = 3 * np.sqrt(-2 * np.log(0.05))
    assert np.abs(east).max(axis=0) == pytest.approx([reach, reach / 30], rel=0.01)
    assert np.abs(north).max(axis=0) == pytest.approx([reach / 30, reach], rel=0.01)


def test_the_points_of_an_ellipse_are_those_where_it_begins_to_hold_errors():
    q, yaw = np.array([[[2.0, 0.7], [0.7, 0.5]]]), np.array([0.0])
    for share, held in ((0.99, True), (1.01, False)):
        errors = share * closure_maps.ellipses(q, yaw)[0]
        assert (closure_maps.inside(errors, np.repeat(q, len(errors), axis=0)) == held).all()


def test_a_gaussian_s_own_ellipse_holds_95_percent_of_its_errors():
    q = np.array([[2.0, 0.7], [0.7, 0.5]])
    errors = np.random.default_rng(0).multivariate_normal([0, 0], q, 20_000)
    assert closure_maps.inside(errors, np.tile(q, (len(errors), 1, 1))).mean() == pytest.approx(0.95, abs=0.005)


def test_every_registration_has_an_ellipse_of_each_method_and_some_are_shown_to_scale():
    figure = closure_maps.closure_ellipses({"borno_8": closures(np.tile([0.5, 0.1], (12, 1)))})
    maps, zooms = figure.axes[:2], figure.axes[2:]
    assert [len(axes.collections[0].get_paths()) for axes in maps] == [12, 12]
    assert len(zooms) == 8
    assert all(len(axes.patches) + len(axes.artists) == 2 for axes in zooms)


def test_the_error_to_scale_is_turned_as_the_ellipse_is():
    figure = closure_maps.closure_ellipses({"borno_8": closures(np.array([[2.0, 0.0]]))})
    dot = next(line for line in figure.axes[2].lines if line.get_marker() == "o")
    assert np.array(dot.get_data()).ravel() == pytest.approx([0.0, 2.0], abs=1e-9)  # along the track, which runs north


def test_inside_and_outside_differ_in_colour():
    figure = closure_maps.closure_ellipses({"borno_8": closures(np.array([[1.0, 0.0], [0.0, 1.0]]))})
    inside, outside = figure.axes[0].collections[0].get_edgecolor()
    assert tuple(inside) != tuple(outside)


def test_without_truth_the_ellipses_are_drawn_and_no_share_is_given():
    figure = closure_maps.closure_ellipses({"mine": closures(np.full((3, 2), np.nan))})
    assert plots.png(figure)
    assert not any("inside" in text.get_text() and "%" in text.get_text() for text in figure.texts)


def test_without_loop_closures_the_figure_says_so():
    assert "no test survey has loop closures" in closure_maps.closure_ellipses({}).texts[0].get_text()
