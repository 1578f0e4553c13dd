"""The map-to-map error: none where submaps agree, and it sees them come apart."""

import numpy as np
import pytest

from pointnetkl import map_to_map, pose

RNG = np.random.default_rng(0)
CLOUD = np.column_stack([RNG.uniform(0, 40, (800, 2)), RNG.normal(0, 0.5, 800)])
HOME = pose.matrix(np.zeros(3), 0.0)


def apart(offset: tuple[float, float, float]) -> np.ndarray:
    return np.array([HOME, pose.matrix(np.array(offset), 0.0)])


def test_the_same_cloud_twice_at_one_place_has_no_error():
    assert map_to_map.MapToMap([CLOUD, CLOUD], 10.0, 1)(apart((0.0, 0.0, 0.0))) == pytest.approx(0.0, abs=1e-12)


def test_the_error_grows_with_the_offset():
    measure = map_to_map.MapToMap([CLOUD, CLOUD], 10.0, 2)
    errors = [measure(apart((0.0, 0.0, z))) for z in (0.0, 0.1, 0.3, 1.0, 3.0)]
    assert errors == sorted(errors)
    # a small vertical offset is itself the distance to the nearest point
    assert errors[1] == pytest.approx(0.1, rel=0.05)


def test_the_error_does_not_depend_on_where_the_map_is_when_cells_move_with_it():
    measure, moved = map_to_map.MapToMap([CLOUD, CLOUD], 10.0, 1), np.array([2000.0, -500.0, 7.0])
    poses = apart((1.0, 0.5, 0.2))
    far = poses.copy()
    far[:, :3, 3] += moved
    assert measure(far) == pytest.approx(measure(poses), rel=1e-6)


def test_a_cell_counts_its_worst_pair_of_submaps():
    two = map_to_map.MapToMap([CLOUD, CLOUD], 10.0, 1)(apart((0.0, 0.0, 2.0)))
    poses = np.array([HOME, HOME, pose.matrix(np.array([0.0, 0.0, 2.0]), 0.0)])
    three = map_to_map.MapToMap([CLOUD, CLOUD, CLOUD], 10.0, 1)(poses)
    assert three == pytest.approx(two)


def test_thinning_changes_the_error_little_because_only_the_asking_points_are_thinned():
    poses = apart((0.7, 0.3, 0.2))
    whole, thinned = (map_to_map.MapToMap([CLOUD, CLOUD[::-1]], 10.0, t)(poses) for t in (1, 4))
    assert thinned == pytest.approx(whole, rel=0.15)


def test_submaps_that_share_no_cell_have_no_error_to_tell():
    assert np.isnan(map_to_map.MapToMap([CLOUD, CLOUD], 10.0, 1)(apart((500.0, 0.0, 0.0))))


@pytest.mark.parametrize(("cell", "thinning"), [(0.0, 1), (10.0, 0)])
def test_settings_without_meaning_are_refused(cell: float, thinning: int):
    with pytest.raises(map_to_map.MapToMapError):
        map_to_map.MapToMap([CLOUD], cell, thinning)
