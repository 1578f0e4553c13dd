"""Terrain classes: what a seabed is drawn from names its submaps, and points tell the slope where nobody knows."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from pointnetkl import simulation
from pointnetkl.reporting import terrain
from pointnetkl.simulation import seabed

LIMITS = terrain.Settings(flat_slope=0.004, rugged_slope=0.02)
QUIET = seabed.Field([1e-6, 1e-6], 100.0)
PLAIN = seabed.Settings(100.0, 500.0, seabed.Relief(0.0, 500.0, 0.5, 1.0, 0.0), hills=QUIET, texture=QUIET)
RNG = np.random.default_rng(3)


def slopes(**by: float) -> pd.DataFrame:
    """Return one submap's slopes."""
    return pd.DataFrame([{**by, "total": float(np.hypot.reduce(list(by.values())))}])


def name(new: set[str] = frozenset(), **by: float) -> str:
    return terrain.classes(slopes(**by), new, LIMITS)[0]


def square(centre: tuple[float, float], half: float = 50.0) -> np.ndarray:
    return np.array(centre) + RNG.uniform(-half, half, (800, 2))


def test_heights_are_the_sum_of_the_features():
    chosen = dataclasses.replace(
        PLAIN, hills=seabed.Field([0.01, 0.2], 150.0), ripples=seabed.Ripples(0.2, 16.0, 30.0, 0.5)
    )
    x, y = square((0, 0), 400).T
    parts = dict(seabed.features(chosen, 5, x, y))
    assert list(parts) == ["relief", "hills", "texture", "ripples"]
    assert sum(parts.values()) - 100.0 == pytest.approx(seabed.heights(chosen, 5, x, y), abs=1e-9)


def test_a_field_contributes_the_slope_that_it_was_drawn_with():
    chosen = dataclasses.replace(PLAIN, texture=seabed.Field([0.02, 0.02], 20.0, 3))
    found = terrain.drawn(chosen, 1, [square((0, 0), 1000)] * 2)
    # across the grain and along it
    assert found["texture"].to_numpy() == pytest.approx(np.sqrt(2) * 0.02, rel=0.1)
    assert found["total"].to_numpy() == pytest.approx(found["texture"].to_numpy(), rel=1e-3)


def test_a_wall_is_where_it_was_put():
    chosen = dataclasses.replace(PLAIN, wall=seabed.Wall(60.0, 90.0, azimuth_deg=0.0, offset_m=400.0))
    found = terrain.drawn(chosen, 1, [square((0, 0)), square((0, 400))])
    assert list(terrain.classes(found, set(), LIMITS)) == ["flat", "wall"]


def test_a_submap_is_named_after_what_gives_it_most_slope():
    assert name(hills=0.001, texture=0.002, ripples=0.003) == "flat"
    assert name(hills=0.001, texture=0.002, ripples=0.006) == "ripples"
    assert name(hills=0.007, texture=0.002, ripples=0.006) == "smooth"
    assert name(hills=0.2, texture=0.03, ridges=0.05) == "rugged"
    assert name(relief=0.3, hills=0.1) == "relief"


def test_what_training_has_not_seen_names_a_submap_even_where_hills_are_steeper():
    assert name({"wall", "ploughmarks"}, hills=0.1, ploughmarks=0.01) == "ploughmarks"
    assert name({"wall", "ploughmarks"}, hills=0.1, ploughmarks=0.001) == "rugged"
    assert name({"wall", "ploughmarks"}, hills=0.1, ploughmarks=0.01, wall=0.02) == "wall"


def test_unseen_is_what_no_training_submap_has_to_hold_on_to():
    training = [slopes(hills=0.1, ripples=0.01, wall=0.0), slopes(hills=0.1, outcrops=0.003, relief=0.2)]
    assert terrain.unseen(training, LIMITS) == {"ridges", "outcrops", "ploughmarks", "wall"}


def test_classes_of_training_are_those_of_its_submaps():
    found, trained = terrain.by_survey({"a": slopes(hills=0.1), "b": slopes(hills=0.001, wall=0.4)}, ["a"], LIMITS)
    assert {survey: list(each) for survey, each in found.items()} == {"a": ["rugged"], "b": ["wall"]}
    assert trained == {"rugged"}


def plane(dip: float, noise_m: float) -> np.ndarray:
    xy = square((0, 0), 60)
    return np.column_stack([xy, dip * xy[:, 0] + noise_m * RNG.normal(size=len(xy))])


@pytest.mark.parametrize("noise_m", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("dip", [0.0, 0.05, 1.5])
def test_points_tell_the_slope_of_a_plane_and_not_their_noise(dip: float, noise_m: float):
    # noise alone tilts planes through 20 of these points by 0.07 a metre of noise
    found = terrain.measured([plane(dip, noise_m) for _ in range(4)])["total"].to_numpy()
    assert found == pytest.approx(dip, abs=0.001 + 0.05 * noise_m)


def test_a_wall_of_points_upon_each_other_has_a_slope():
    points = np.array([[0.0, 0.0, z] for z in range(30)])
    assert np.isfinite(terrain.measured([points])["total"][0])


def settings(**changes: object) -> simulation.Settings:
    layout = simulation.Layout(2, 100.0, 50.0, 0.0, 0.0, 0.0)
    wall = dataclasses.replace(PLAIN, wall=seabed.Wall(60.0, 90.0, 0.0, 400.0))
    base = simulation.Settings(
        1, "hugin", "data/none", 50.0, 1.0, 1.0, layout, crs="EPSG:32632", centre_m=[1000.0, 2000.0], terrain=wall
    )
    return dataclasses.replace(base, **changes)


def test_a_submap_is_looked_for_where_its_pose_and_the_map_s_origin_put_it():
    poses = pd.DataFrame({"x_m": [500.0, 100.0], "y_m": [700.0, 300.0], "z_m": 0.0, "yaw_rad": [1.0, 0.0]})
    clouds = [np.column_stack([square((0, 0)), np.zeros(800)])] * 2
    # the wall stands at northing 2400 of the CRS, and the map's origin lies at northing 1700
    found = terrain.slopes(clouds, poses, np.array([500.0, 1700.0]), "EPSG:32632", settings())
    assert list(terrain.classes(found, set(), LIMITS)) == ["wall", "flat"]


@pytest.mark.parametrize(
    ("crs", "chosen"),
    [("EPSG:32632", None), ("EPSG:32633", settings()), ("EPSG:32632", settings(grid="data/grids/real.tif"))],
)
def test_where_nobody_knows_the_terrain_points_tell_it(crs: str, chosen: simulation.Settings | None):
    poses = pd.DataFrame({"x_m": [0.0], "y_m": [700.0], "z_m": 0.0, "yaw_rad": 0.0})
    found = terrain.slopes([plane(0.1, 0.0)], poses, np.array([500.0, 1700.0]), crs, chosen)
    assert list(found) == ["total"]
    assert found["total"][0] == pytest.approx(0.1)
    assert list(terrain.classes(found, {"wall"}, LIMITS)) == ["rugged"]


def test_limits_that_leave_no_room_are_refused():
    with pytest.raises(ValueError, match=r"rugged_slope is 0\.003, must be above"):
        terrain.Settings(0.004, 0.003)
