"""The authors' map-to-map error: repeatable, and of another size where only the map's extent is another."""

import numpy as np
import pytest

from pointnetkl.slam.consistency import map_to_map
from pointnetkl.slam.consistency.map_to_map_auvlib import MapToMapAuvlib
from pointnetkl.surveys import pose

RNG = np.random.default_rng(0)
SIZE_M = 100.0


def patch(points: int, width: float = SIZE_M) -> np.ndarray:
    return np.column_stack([RNG.uniform(0, width, (points, 2)), np.zeros(points)])


def poses_at(*positions: tuple[float, float, float]) -> np.ndarray:
    return np.array([pose.matrix(np.array(position), 0.0) for position in positions])


CLOUDS = [patch(20_000), patch(20_000)]
APART = (0.0, 0.0, 0.4)
# a third submap, alone and far away: it has nothing to agree or disagree with
FAR = [*CLOUDS, patch(50, 1.0)]


def test_the_same_cloud_twice_at_one_place_has_no_error():
    assert MapToMapAuvlib([CLOUDS[0]] * 2, 1)(poses_at((0, 0, 0), (0, 0, 0))) == 0.0


def test_equal_seeds_give_equal_errors_and_others_nearly_equal_ones():
    poses = poses_at((0, 0, 0), APART)
    first, again, other = (MapToMapAuvlib(CLOUDS, seed)(poses) for seed in (1, 1, 2))
    assert first == again
    assert other != first
    assert other == pytest.approx(first, rel=0.02)


def test_the_error_does_not_depend_on_the_number_of_workers(monkeypatch: pytest.MonkeyPatch):
    poses, errors = poses_at((0, 0, 0), APART), []
    for workers in ("1", "3"):
        monkeypatch.setenv("POINTNETKL_WORKERS", workers)
        errors.append(MapToMapAuvlib(CLOUDS, 1)(poses))
    assert errors[0] == errors[1]


def test_submaps_that_share_no_cell_have_no_error_to_tell():
    assert np.isnan(MapToMapAuvlib(CLOUDS, 1)(poses_at((0, 0, 0), (500, 0, 0))))


def test_where_points_lie_dense_it_is_the_height_between_two_planes():
    clouds = [patch(40_000, 10.0), patch(40_000, 10.0)]
    assert MapToMapAuvlib(clouds, 1)(poses_at((0, 0, 0), (0, 0, 2))) == pytest.approx(2.0, rel=0.01)


def test_a_far_submap_that_overlaps_nothing_changes_it_and_not_the_error_of_fixed_cells():
    near, far = poses_at((0, 0, 0), APART), poses_at((0, 0, 0), APART, (3000, 3000, 0))
    fixed = map_to_map.MapToMap(CLOUDS, 15.0, 1)(near), map_to_map.MapToMap(FAR, 15.0, 1)(far)
    stretched = MapToMapAuvlib(CLOUDS, 1)(near), MapToMapAuvlib(FAR, 1)(far)
    assert fixed[0] == pytest.approx(fixed[1], rel=1e-12)
    # small cells, of 0.2 m here, only count where the submaps happen to have points next to each other
    assert stretched[1] > 1.2 * stretched[0]


def test_a_draw_counts_the_largest_distance_between_the_submaps_in_a_cell():
    # one point each: no chance, and three heights whose largest step is 3
    clouds = [np.array([[0.0, 0.0, z], [9.0, 9.0, z]]) for z in (0.0, 1.0, 4.0)]
    poses = poses_at((0, 0, 0), (0, 0, 0), (0, 0, 0))
    assert MapToMapAuvlib(clouds, 1)(poses) == pytest.approx(4.0)
