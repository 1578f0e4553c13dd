"""The seabed before and after: one scale of depths, and differences that are those of the maps."""

import numpy as np
import pytest

from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.slam import maps as slam_maps
from pointnetkl.reporting.slam.maps import Seabed


def seabed(**offsets_m: float) -> Seabed:
    """A plane that slopes to the east, at trajectories that are so many metres west of the truth."""
    x, y = np.mgrid[0:200:2.0, 0:100:2.0].reshape(2, -1)
    points = np.stack([x, y, -50 - 0.1 * x], -1)
    return Seabed({**{name: points - [offset, 0, 0] for name, offset in offsets_m.items()}, "truth": points}, 2.0)


def images(maps: Seabed) -> list[np.ndarray]:
    """Return what the figure's maps show, differences last: depth and shade of each trajectory come before."""
    figure = slam_maps.bathymetry({"borno_8": maps})
    return [np.ma.filled(image.get_array(), np.nan) for axes in figure.axes for image in axes.images]


def test_depth_maps_and_differences_have_a_panel_each_and_a_bar_for_each_scale():
    figure = slam_maps.bathymetry({"borno_8": seabed(corrupted=20.0, network=2.0), "mine": seabed(corrupted=20.0)})
    assert len(figure.axes) == (3 + 2 + 2) + (2 + 1 + 2)


def test_a_map_moved_down_a_slope_is_deeper_by_what_the_slope_says():
    *_, corrupted, network = images(seabed(corrupted=20.0, network=2.0))
    assert np.nanmedian(corrupted) == pytest.approx(2.0, abs=0.05)
    assert np.nanmedian(network) == pytest.approx(0.2, abs=0.05)


def test_depths_share_one_scale():
    figure = slam_maps.bathymetry({"borno_8": seabed(corrupted=20.0, network=2.0)})
    assert len({axes.images[0].get_clim() for axes in figure.axes[:3]}) == 1


def test_maps_that_agree_or_never_meet_are_drawn():
    for maps in (seabed(corrupted=0.0), seabed(corrupted=1e4)):
        assert plots.png(slam_maps.bathymetry({"mine": maps}))
