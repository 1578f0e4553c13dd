"""Trajectories: one scale a survey, a panel a method, displacements from the truth without the common motion."""

import itertools

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.slam import trajectories
from pointnetkl.reporting.slam.trajectories import Tracks
from pointnetkl.surveys import pose

SQUARE = 100.0 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0.2, 0]])


def tracks(truth: bool = True) -> Tracks:
    """A square track with one loop closure, solved well by one method and badly by another."""
    reference = {"truth": SQUARE} if truth else {}
    positions = {
        **reference,
        "gt": SQUARE + np.array([1, 0, 0]),
        "navigation": 1.01 * SQUARE,
        "corrupted": 1.2 * SQUARE,
    }
    return Tracks({**positions, "network": 1.02 * SQUARE, "constant": 1.05 * SQUARE}, np.array([[0, 4]]))


def frames(axes: Axes) -> list[Rectangle]:
    """Return the frames of the maps in an axes."""
    return [child for child in axes.get_children() if isinstance(child, Rectangle) and child is not axes.patch]


def test_there_is_a_map_for_each_trajectory_and_one_for_each_method_s_displacement():
    figure = trajectories.trajectories({"borno_8": tracks(), "mine": tracks(truth=False)})
    # as they are: truth where known, GT, navigation, corrupted, network; then network and constant
    assert [len(frames(axes)) for axes in figure.axes] == [5, 2, 4, 2]


def test_maps_of_one_survey_have_one_size_and_do_not_overlap():
    for axes in trajectories.trajectories({"borno_8": tracks()}).axes:
        boxes = [frame.get_bbox() for frame in frames(axes)]
        assert len({(round(box.width, 6), round(box.height, 6)) for box in boxes}) == 1
        assert all(before.x1 < after.x0 for before, after in itertools.pairwise(boxes))
        assert axes.get_xlim()[0] <= boxes[0].x0
        assert boxes[-1].x1 < axes.get_xlim()[1]


def test_a_map_turned_and_moved_as_a_whole_has_no_displacement():
    T = pose.matrix(np.array([30.0, -7.0, 0.0]), 0.3)
    turned = Tracks({"truth": SQUARE, "network": pose.transform(T, SQUARE)}, np.zeros((0, 2), int))
    assert np.abs(turned.displacements("network")).max() == pytest.approx(0.0, abs=1e-9)
    assert np.abs(tracks().displacements("constant")).max() > 1


def test_what_is_drawn_is_the_truth_plus_the_magnified_displacement():
    square = tracks()
    factor = trajectories.magnification(square)
    assert factor > 1
    drawn = trajectories.trajectories({"borno_8": square}).axes[1].collections[0].get_segments()  # of the first map
    assert drawn[0][1] == pytest.approx(SQUARE[1, :2] + factor * square.displacements("network")[1])


def test_a_method_that_gave_up_does_not_set_the_scale_of_the_others():
    square = tracks()
    worse = {**square.positions, "cello": 1.02 * SQUARE, "hessian": 9.0 * SQUARE}
    assert trajectories.magnification(Tracks(worse, square.closures)) >= 0.5 * trajectories.magnification(square)


def test_a_survey_without_truth_and_closures_is_compared_with_gt():
    alone = Tracks(tracks(truth=False).positions, np.zeros((0, 2), int))
    assert alone.reference == "gt"
    figure = trajectories.trajectories({"mine": alone})
    assert plots.png(figure)
    assert any("aligned with GT" in text.get_text() for text in figure.texts)
