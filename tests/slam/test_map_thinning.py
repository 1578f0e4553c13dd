"""Thinning and the map-to-map error: what is thinned matters."""

import numpy as np
import pandas as pd
import pytest

from pointnetkl.reporting.slam import tables as slam_tables
from pointnetkl.slam.consistency import map_to_map
from pointnetkl.surveys import pose

RNG = np.random.default_rng(3)
CLOUDS = [np.column_stack([RNG.uniform(0, 60, (3000, 2)), RNG.normal(0, 0.1, 3000)]) for _ in range(2)]
POSES = np.array([pose.matrix(np.zeros(3), 0.0)] * 2)


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return map_to_map.thinning_table("mine", CLOUDS, POSES, 15.0)


def test_without_thinning_both_ways_are_the_measure_itself(table: pd.DataFrame):
    whole = map_to_map.MapToMap(CLOUDS, 15.0, 1)(POSES)
    assert table.loc[0, ["thinning", "map_to_map_m", "both_thinned_m"]].tolist() == [1, whole, whole]


def test_thinning_the_points_that_answer_makes_one_surface_seem_two(table: pd.DataFrame):
    # points of a plane four times as far between are twice as far from each other
    by_thinning = table.set_index("thinning")["both_thinned_m"]
    assert by_thinning[4] > 1.5 * by_thinning[1]
    assert by_thinning.is_monotonic_increasing


def test_thinning_the_points_that_ask_leaves_a_full_cell_as_it_is(table: pd.DataFrame):
    # where both submaps fill every cell
    assert table["map_to_map_m"].tolist() == pytest.approx([table["map_to_map_m"][0]] * 4, rel=0.05)


def test_submaps_that_barely_meet_are_overlooked_by_fewer_points():
    # a few points of the second reach 1 m into cells of 5 m that the first fills
    poses = np.array([POSES[0], pose.matrix(np.array([-59.0, 0.0, 0.0]), 0.0)])
    table = map_to_map.thinning_table("mine", [CLOUDS[0], CLOUDS[1][:400]], poses, 5.0)
    assert table["cells"].is_monotonic_decreasing
    assert table["cells"].iloc[-1] < table["cells"].iloc[0]


def test_the_table_has_the_ratio_to_the_whole_clouds(table: pd.DataFrame):
    frame = slam_tables.thinning(table, {"mine": {"simulated": True}}).frame
    assert frame["ratio"][0] == 1.0
    assert frame["ratio"][2] == table["map_to_map_m"][2] / table["map_to_map_m"][0]
