"""The error along the track: as it is, and with what is common to all submaps taken out."""

import numpy as np
import pytest

from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.slam import along_track
from pointnetkl.reporting.slam.trajectories import Tracks
from pointnetkl.surveys import pose

TRACK = np.stack([np.linspace(0, 900, 10), np.sin(np.arange(10.0)), np.zeros(10)], -1)


def tracks(truth: bool = True) -> Tracks:
    """A track with two loop closures, corrupted by a turn about its first submap."""
    turned = pose.transform(pose.matrix(np.zeros(3), 0.1), TRACK)
    truths = {"truth": TRACK} if truth else {}
    return Tracks(
        {**truths, "gt": TRACK + np.array([0, 1, 0]), "corrupted": turned, "network": TRACK}, np.array([[0, 7], [1, 8]])
    )


def test_a_turn_about_the_first_submap_grows_along_the_track_and_vanishes_aligned():
    error = along_track.errors(tracks(), "corrupted", aligned=False)
    assert error[0] < 1e-9
    assert (np.diff(error) > 0).all()
    assert along_track.errors(tracks(), "corrupted", aligned=True) == pytest.approx(np.zeros(10), abs=1e-9)


def test_each_survey_has_both_panels_and_the_submaps_that_close_loops_are_marked():
    figure = along_track.along({"borno_8": tracks(), "mine": tracks(truth=False)})
    assert len(figure.axes) == 4
    marks = next(line for line in figure.axes[0].lines if line.get_label() == "closes a loop")
    assert list(marks.get_xdata()) == [7, 8]
    assert "against truth" in figure.axes[0].get_title()
    assert "against GT" in figure.axes[2].get_title()


def test_a_survey_without_closures_is_drawn():
    assert plots.png(along_track.along({"mine": Tracks(tracks(truth=False).positions, np.zeros((0, 2), int))}))
