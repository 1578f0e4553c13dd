"""Normals: those of a dense eigendecomposition, for clean clouds and for noisy copies that share neighbour lists."""

import numpy as np
import pytest

import terrains
from pointnetkl.registration import gicp, reference
from pointnetkl.registration.gicp import normals

SETTINGS = gicp.Settings(neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50)


def copy_normals(cloud: gicp.Cloud, noise: np.ndarray) -> np.ndarray:
    """Return normals (n, 3) of the cloud's points with noise (n, 3) added."""
    source = cloud.as_source(cloud, np.zeros(3))
    n = len(cloud.points)
    upwards = np.empty(3 * (n + normals.LANES), np.float32)
    rows, sums = np.empty(normals.ROW * n, np.float32), np.zeros_like(source.neighbourhoods)
    shifts = np.ascontiguousarray(noise.T, np.float32)
    normals.fill_normals(source.points, shifts, source.neighbourhoods, source.lists, rows, sums, upwards)
    return upwards[: 3 * n].reshape(-1, 3)


@pytest.mark.parametrize("points", [37, 2000])
@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.5, 5.0])
@pytest.mark.parametrize("kind", [*terrains.AMPLITUDES_M, "ridge"])
def test_a_noisy_copys_normals_are_those_of_its_own_points(kind: str, noise_m: float, points: int) -> None:
    cloud = gicp.prepare(terrains.cloud(kind, points), SETTINGS)
    noise = np.random.default_rng(1).normal(size=cloud.points.shape).astype(np.float32) * np.float32(noise_m)
    upwards, expected = copy_normals(cloud, noise), reference.normals(cloud.points + noise, cloud.lists)
    assert np.allclose(np.linalg.norm(upwards, axis=1), 1, atol=1e-5)
    assert (upwards[:, 2] >= 0).all()
    # where two eigenvalues are nearly the same, any direction between theirs is as good
    assert np.mean(np.abs(np.sum(upwards * expected, axis=1)) > 1 - 1e-5) > (0.999 if noise_m < 1 else 0.99)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 500.0])
def test_normals_do_not_depend_on_the_unit_of_length(scale: float) -> None:
    points = terrains.cloud("rugged", 500)
    metres, other = (gicp.prepare(points * s, SETTINGS) for s in (1.0, scale))
    matching_rows = [np.lexsort(cloud.points.T) for cloud in (metres, other)]
    assert np.allclose(metres.normals[matching_rows[0]], other.normals[matching_rows[1]], atol=1e-5)


def test_points_in_one_place_have_a_vertical_normal() -> None:
    assert np.array_equal(gicp.prepare(np.ones((40, 3)), SETTINGS).normals, np.tile([0, 0, 1], (40, 1)))
