"""The figure of the authors' whitening: the same ellipse, turned; and the page shows what the function draws."""

from pathlib import Path

import numpy as np
import pytest
from docs import authors_slam

Q = authors_slam.ANTARCTIC


def test_the_ellipse_that_acts_has_the_same_axes_in_other_directions():
    given, acts = (np.array(line.get_data()) for line in authors_slam.whitening(Q).axes[0].lines[:3:2])
    radii = [np.linalg.norm(each, axis=0) for each in (given, acts)]
    assert radii[0].max() == pytest.approx(radii[1].max(), rel=1e-3)
    assert radii[0].min() == pytest.approx(radii[1].min(), rel=1e-3)
    angles = [np.arctan2(*each[::-1, np.linalg.norm(each, axis=0).argmax()]) % np.pi for each in (given, acts)]
    assert abs(angles[0] - angles[1]) > np.radians(10)


def test_a_residual_of_one_metre_costs_what_its_information_says():
    cost = authors_slam.whitening(Q).axes[1].lines[0]
    assert cost.get_ydata()[0] == pytest.approx(np.linalg.inv(Q)[0, 0])


def test_the_page_names_its_figure_and_the_numbers_of_the_block():
    docs = Path(__file__).parents[2] / "docs"
    text = (docs / "authors_slam.md").read_text()
    assert (docs / "authors_slam.png").is_file()
    assert "(authors_slam.png)" in text
    assert all(f"{value:.2f}" in text for value in Q.ravel())
