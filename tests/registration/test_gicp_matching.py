"""Matching: the two nearest points are exactly those of a k-d tree, for a query anywhere."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import terrains
from pointnetkl.registration import gicp
from pointnetkl.registration.gicp import matching

SETTINGS = gicp.Settings(neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50)


def matched(cloud: gicp.Cloud, queries: np.ndarray, max_distance: float = 1e6) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the numbers and distances (n, 2) of the two nearest, and how many queries the table could answer."""
    numbers, distances, answered = [], [], 0
    for x, y, z in (queries - cloud.centre).astype(np.float32):
        near, other, near_m, other_m, exact = matching.look_up(x, y, z, cloud.as_target)
        answered += exact
        if not exact:
            near, other, near_m, other_m = matching.search(x, y, z, np.float32(max_distance), -1, -1, cloud.as_target)
        numbers.append((near, other))
        distances.append((near_m, other_m))
    return np.array(numbers), np.array(distances), answered


@pytest.mark.parametrize("kind", [*terrains.AMPLITUDES_M, "ridge"])
def test_the_two_nearest_are_those_of_a_k_d_tree(kind: str) -> None:
    cloud = gicp.prepare(terrains.cloud(kind, 800), SETTINGS)
    rng = np.random.default_rng(1)
    queries = cloud.points[rng.integers(len(cloud.points), size=500)] + rng.normal(size=(500, 3)) * [6, 6, 0.5]
    _, distances, answered = matched(cloud, queries)
    expected, _ = cKDTree(cloud.points).query(queries, 2)
    assert np.allclose(distances, expected, rtol=1e-5, atol=1e-4)
    assert answered > 100  # else the table is of no use


@given(seed=st.integers(0, 10_000), stretch=st.sampled_from([0.01, 1.0, 30.0]), far=st.sampled_from([0.1, 3.0, 50.0]))
def test_a_look_up_that_says_it_is_exact_is_exact_on_any_cloud(seed: int, stretch: float, far: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.standard_cauchy((60, 3)).clip(-1e3, 1e3) * [1, stretch, 1]
    cloud = gicp.prepare(np.vstack([points, points[:5]]), SETTINGS)
    queries = points[:20] + rng.normal(size=(20, 3)) * far
    _, distances, _ = matched(cloud, queries)
    expected, _ = cKDTree(cloud.points).query(queries, 2)
    assert np.allclose(distances, expected, rtol=1e-4, atol=1e-2)


def test_a_search_ends_at_the_largest_distance() -> None:
    cloud = gicp.prepare(terrains.cloud("mild", 300), SETTINGS)
    near, other, near_m, other_m = matching.search(
        np.float32(200), np.float32(0), np.float32(0), np.float32(20), -1, -1, cloud.as_target
    )
    assert (near, other, near_m, other_m) == (-1, -1, 20, 20)


def test_hints_change_nothing() -> None:
    cloud = gicp.prepare(terrains.cloud("rugged", 300), SETTINGS)
    rng = np.random.default_rng(2)
    for x, y, z in (rng.normal(size=(50, 3)) * [60, 60, 3]).astype(np.float32):
        a, b = rng.choice(len(cloud.points), 2, replace=False)
        plain = matching.search(x, y, z, np.float32(1e3), -1, -1, cloud.as_target)
        assert matching.search(x, y, z, np.float32(1e3), int(a), int(b), cloud.as_target) == plain
