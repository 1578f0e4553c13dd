"""The map-to-map error: zero where submaps agree, larger as they come apart, and what thinning does to it."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import cKDTree

from pointnetkl.slam.consistency import map_kernel, map_to_map
from pointnetkl.slam.graph import footprint
from pointnetkl.surveys import pose

RNG = np.random.default_rng(0)
CLOUD = np.column_stack([RNG.uniform(0, 40, (800, 2)), RNG.normal(0, 0.5, 800)])
HOME = pose.matrix(np.zeros(3), 0.0)
PLANES = [np.column_stack([RNG.uniform(0, 60, (3000, 2)), RNG.normal(0, 0.1, 3000)]) for _ in range(2)]
TOGETHER = np.array([HOME, HOME])


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


def plain(clouds: list[np.ndarray], poses: np.ndarray, cell: float, thinning: int) -> dict[int, float]:
    """The definition, word by word: each cell's worst ordered pair of submaps."""
    placed = [pose.transform(T, cloud) for T, cloud in zip(poses, clouds, strict=True)]
    keys = [footprint.keys(points[::thinning], cell) for points in placed]
    worst = {}
    for key in np.unique(np.concatenate(keys)):
        here = [i for i, cells in enumerate(keys) if key in cells]
        means = [
            cKDTree(placed[b]).query(placed[a][::thinning][keys[a] == key])[0].mean()
            for a in here
            for b in here
            if a != b
        ]
        if means:
            worst[int(key)] = max(means)
    return worst


def random_map(rng: np.random.Generator) -> tuple[list[np.ndarray], np.ndarray]:
    sizes = ((500, 60.0), (40, 25.0), (900, 80.0), (1, 1.0), (300, 40.0))
    clouds = [np.column_stack([rng.uniform(0, w, (n, 2)), rng.normal(0, 2, n)]) for n, w in sizes]
    poses = [pose.matrix(np.array([*rng.uniform(-30, 30, 2), rng.normal()]), rng.uniform(-3, 3)) for _ in clouds]
    return clouds, np.array(poses)


@pytest.mark.parametrize("thinning", [1, 3])
def test_cells_are_those_of_the_definition(thinning: int):
    clouds, poses = random_map(np.random.default_rng(5))
    cells = map_to_map.MapToMap(clouds, 12.0, thinning).cells(poses)
    expected = plain(clouds, poses, 12.0, thinning)
    np.testing.assert_array_equal((cells.column << 32) + cells.row, list(expected))
    np.testing.assert_allclose(cells.error_m, list(expected.values()), rtol=1e-9)


def test_the_error_is_the_root_mean_square_of_its_cells():
    clouds, poses = random_map(np.random.default_rng(6))
    measure = map_to_map.MapToMap(clouds, 12.0, 1)
    assert measure(poses) == np.sqrt(np.mean(measure.cells(poses).error_m ** 2))


def test_a_patch_lifted_off_another_is_as_far_from_it_as_it_was_lifted():
    east, north = np.meshgrid(np.arange(0.5, 40, 1.0), np.arange(0.5, 40, 1.0))
    patch = np.column_stack([east.ravel(), north.ravel(), np.zeros(east.size)])
    cells = map_to_map.MapToMap([patch, patch], 10.0, 1).cells(apart((0.0, 0.0, 0.7)))
    np.testing.assert_allclose(cells.error_m, 0.7)
    assert cells.column.tolist() == np.repeat(range(4), 4).tolist()
    assert cells.row.tolist() == [*range(4)] * 4


def test_the_order_of_the_submaps_changes_nothing():
    clouds, poses = random_map(np.random.default_rng(7))
    forth = map_to_map.MapToMap(clouds, 12.0, 1).cells(poses)
    back = map_to_map.MapToMap(clouds[::-1], 12.0, 1).cells(poses[::-1])
    for first, second in zip(forth, back, strict=True):
        np.testing.assert_allclose(first, second, rtol=1e-12)


def test_the_error_does_not_depend_on_the_number_of_workers(monkeypatch: pytest.MonkeyPatch):
    clouds, poses = random_map(np.random.default_rng(8))
    errors = []
    for workers in ("1", "3"):
        monkeypatch.setenv("POINTNETKL_WORKERS", workers)
        errors.append(map_to_map.MapToMap(clouds, 12.0, 1).cells(poses).error_m.tobytes())
    assert errors[0] == errors[1]


def test_a_cell_knows_its_column_and_row_west_and_south_of_the_origin_too():
    points = np.random.default_rng(9).uniform(-1e5, 1e5, (300, 2))
    column, row = footprint.places(footprint.keys(points, 7.0))
    np.testing.assert_array_equal(np.stack([column, row], -1), np.floor(points / 7.0))


@given(arrays(np.float64, st.tuples(st.integers(1, 60), st.just(3)), elements=st.floats(-50, 50)))
def test_every_point_of_a_cloud_is_in_its_bucket(cloud: np.ndarray):
    to = map_kernel.buckets([cloud, cloud])
    assert to.starts[to.first[1] - 1] == len(cloud)
    assert to.starts[-1] == 2 * len(cloud)
    np.testing.assert_array_equal(np.sort(to.points[: len(cloud)], axis=0), np.sort(cloud, axis=0))
    measure = map_to_map.MapToMap([cloud, cloud], 1000.0, 1)
    assert measure(apart((0.0, 0.0, 0.0))) == pytest.approx(0.0, abs=1e-9)


def test_submaps_that_share_no_cell_have_no_error_to_tell():
    assert np.isnan(map_to_map.MapToMap([CLOUD, CLOUD], 10.0, 1)(apart((500.0, 0.0, 0.0))))


@pytest.mark.parametrize(("cell", "thinning"), [(0.0, 1), (10.0, 0)])
def test_settings_without_meaning_are_refused(cell: float, thinning: int):
    with pytest.raises(map_to_map.MapToMapError):
        map_to_map.MapToMap([CLOUD], cell, thinning)


@pytest.fixture(scope="module")
def thinning() -> pd.DataFrame:
    return map_to_map.thinning_table("mine", PLANES, TOGETHER, 15.0)


def test_without_thinning_both_ways_are_the_measure_itself(thinning: pd.DataFrame):
    whole = map_to_map.MapToMap(PLANES, 15.0, 1)(TOGETHER)
    assert thinning.loc[0, ["thinning", "map_to_map_m", "both_thinned_m"]].tolist() == [1, whole, whole]


def test_thinning_the_points_that_answer_makes_one_surface_seem_two(thinning: pd.DataFrame):
    # points of a plane four times as far between are twice as far from each other
    by_thinning = thinning.set_index("thinning")["both_thinned_m"]
    assert by_thinning[4] > 1.5 * by_thinning[1]
    assert by_thinning.is_monotonic_increasing


def test_thinning_the_points_that_ask_leaves_a_full_cell_as_it_is(thinning: pd.DataFrame):
    # where both submaps fill every cell
    assert thinning["map_to_map_m"].tolist() == pytest.approx([thinning["map_to_map_m"][0]] * 4, rel=0.05)


def test_submaps_that_barely_meet_are_overlooked_by_fewer_points():
    # a few points of the second reach 1 m into cells of 5 m that the first fills
    poses = np.array([TOGETHER[0], pose.matrix(np.array([-59.0, 0.0, 0.0]), 0.0)])
    thinning = map_to_map.thinning_table("mine", [PLANES[0], PLANES[1][:400]], poses, 5.0)
    assert thinning["cells"].is_monotonic_decreasing
    assert thinning["cells"].iloc[-1] < thinning["cells"].iloc[0]
