"""The figure of docs/authors_slam.md: the slip turns the ellipse and changes what a residual costs."""

import runpy
from pathlib import Path

import numpy as np
import pytest

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "docs/authors_slam.py"))
Q = SCRIPT["ANTARCTIC"]
FIGURE = SCRIPT["whitening"](Q)


def test_the_ellipse_that_acts_has_the_same_axes_in_other_directions():
    given, acting = (np.array(line.get_data()) for line in FIGURE.axes[0].lines[:3:2])
    radii = [np.linalg.norm(ellipse, axis=0) for ellipse in (given, acting)]
    assert radii[0].max() == pytest.approx(radii[1].max(), rel=1e-3)
    assert radii[0].min() == pytest.approx(radii[1].min(), rel=1e-3)
    longest = [ellipse[:, np.linalg.norm(ellipse, axis=0).argmax()] for ellipse in (given, acting)]
    angles = [np.arctan2(y, x) % np.pi for x, y in longest]
    assert abs(angles[0] - angles[1]) > np.radians(10)


def test_a_residual_of_one_metre_costs_what_its_information_says():
    cost = FIGURE.axes[1].lines[0]
    assert cost.get_ydata()[0] == pytest.approx(np.linalg.inv(Q)[0, 0])
