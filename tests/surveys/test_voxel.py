"""A canonical cloud has zero mean, lies in the unit sphere, and has one point a voxel."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import whole_survey
from pointnetkl import segmentation
from pointnetkl.surveys import submap, voxel
from pointnetkl.surveys.voxel import Canonical, Clouds, VoxelError
from pointnetkl.workflow import artifacts
from small_survey import sail

ROOT = Path(__file__).parents[2]
VOXEL = 0.05


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).normal([50.0, -20.0, -100.0], [30.0, 20.0, 3.0], (3000, 3))


def test_a_cloud_has_zero_mean_and_a_largest_norm_of_one_before_voxels(points: np.ndarray):
    unit, radius = voxel.normalised(points)
    assert np.abs(unit.mean(axis=0)).max() < 1e-12
    assert np.linalg.norm(unit, axis=1).max() == pytest.approx(1.0, abs=1e-15)
    assert unit * radius + points.mean(axis=0) == pytest.approx(points, abs=1e-9)


def test_a_voxel_keeps_one_point_and_that_is_its_mean(points: np.ndarray):
    cloud = voxel.canonical(points, VOXEL)
    unit, _ = voxel.normalised(points)
    corner = unit.min(axis=0) - VOXEL / 2
    before, after = (np.floor((p - corner) / VOXEL).astype(int) for p in (unit, cloud.points.astype(float)))
    occupied, number = np.unique(before, axis=0, return_inverse=True)
    assert len(cloud.points) == len(occupied) < len(unit)
    sums = np.stack([np.bincount(number.ravel(), weights=unit[:, k]) for k in range(3)], -1)
    means = (sums / np.bincount(number.ravel())[:, None]).astype(np.float32)
    assert means[np.lexsort(means.T[::-1])] == pytest.approx(cloud.points, abs=1e-6)
    assert len(np.unique(after, axis=0)) == len(after)


def test_moving_turning_or_scaling_a_submap_moves_nothing_that_it_should_not(points: np.ndarray):
    cloud = voxel.canonical(points, VOXEL)
    moved = voxel.canonical(points + np.array([1000.0, -500.0, 30.0]), VOXEL)
    larger = voxel.canonical(3 * points, VOXEL)
    assert (moved.radius, larger.radius) == pytest.approx((cloud.radius, 3 * cloud.radius))
    assert moved.points == pytest.approx(cloud.points, abs=1e-6)
    assert larger.points == pytest.approx(cloud.points, abs=1e-6)


def test_the_same_cloud_gives_the_same_bytes(points: np.ndarray):
    once, twice = (voxel.canonical(points, VOXEL).points for _ in range(2))
    assert once.tobytes() == twice.tobytes()
    assert once.dtype == np.float32


def test_clouds_come_back_from_the_file_as_they_were(tmp_path: Path, points: np.ndarray):
    canonical = [voxel.canonical(points[start:], VOXEL) for start in (0, 1000, 2000)]
    artifacts.write_arrays(tmp_path / "c.npz", Clouds.join([0, 1, 4], canonical).to_arrays(), {"survey": "small"})
    clouds = Clouds.from_arrays(artifacts.read_arrays(tmp_path / "c.npz")[0])
    assert len(clouds) == 3
    assert clouds.submap.tolist() == [0, 1, 4]
    for i, cloud in enumerate(canonical):
        assert np.array_equal(clouds.cloud(i).points, cloud.points)
        assert clouds.cloud(i).radius == cloud.radius


def test_sigma_z_of_a_tilted_plane_is_what_its_slope_says():
    # z = s x over a square of half side 1 centred at 0: Var z = s^2 / 3, in units of the radius sqrt(2 + s^2)
    side, slope = np.linspace(-1, 1, 201), 0.3
    x, y = (axis.ravel() for axis in np.meshgrid(side, side))
    unit, radius = voxel.normalised(np.c_[x, y, slope * x])
    clouds = Clouds.join([0, 1], [Canonical(unit.astype(np.float32), radius)] * 2)
    assert radius == pytest.approx(np.sqrt(2 + slope**2))
    assert voxel.sigma_z(clouds) == pytest.approx(slope / np.sqrt(3 * (2 + slope**2)), rel=0.01)


@pytest.mark.parametrize("bad", [np.zeros((0, 3)), np.ones((5, 3)), np.full((5, 3), np.nan)])
def test_a_cloud_without_extent_is_refused_by_name(bad: np.ndarray):
    with pytest.raises(VoxelError, match=r"^small, submap 3: "):
        voxel.canonical(bad, VOXEL, "small, submap 3")


def test_stored_clouds_that_do_not_fit_together_are_refused(points: np.ndarray):
    arrays = Clouds.join([0, 1], [voxel.canonical(points, VOXEL)] * 2).to_arrays()
    for spoilt in (
        {"offset": arrays["offset"][:-1]},
        {"offset": arrays["offset"] + 1},
        {"offset": arrays["offset"][[0, 0, 2]]},
        {"points": arrays["points"][:, :2]},
        {"radius": arrays["radius"][:1]},
    ):
        with pytest.raises(VoxelError, match=r"c\.npz: its arrays do not fit"):
            Clouds.from_arrays(arrays | spoilt, "c.npz")
    with pytest.raises(VoxelError, match=r"c\.npz: lacks the array radius"):
        Clouds.from_arrays({k: v for k, v in arrays.items() if k != "radius"}, "c.npz")


@pytest.mark.parametrize("share", [0.0, -0.01, 2.0])
def test_a_voxel_that_is_no_share_of_the_sphere_is_refused(share: float):
    with pytest.raises(ValueError, match="voxel is"):
        voxel.Settings(share)


@pytest.mark.slow
def test_the_stage_makes_a_cloud_of_every_submap(tmp_path: Path):
    survey = sail(lines=1)
    segments = whole_survey.cut(
        segmentation.segment, "small", survey.pings, [survey.soundings], 100.0, 4.0, segmentation.Settings(0, 30.0)
    )
    artifacts.write_table(tmp_path / "s.parquet", submap.to_table(segments.submaps), submap.POINTS, {})
    (tmp_path / "params.yaml").write_text("voxelise: {voxel: 0.01}\n")
    script = [sys.executable, ROOT / "pipeline/voxelise.py", "small", "--submaps", "s.parquet", "--clouds", "c.npz"]
    done = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    clouds = Clouds.from_arrays(artifacts.read_arrays(tmp_path / "c.npz")[0])
    assert clouds.submap.tolist() == [0, 1, 2]
    assert clouds.radius == pytest.approx([np.hypot(50, 40)] * 3, rel=0.05)
