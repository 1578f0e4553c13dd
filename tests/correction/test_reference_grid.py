"""A known seabed as points in the survey's frame, whatever its sign, spacing and level."""

import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio

import raw_survey
from pointnetkl.correction.preparation import reference
from pointnetkl.correction.preparation.reference import Reference
from pointnetkl.correction.result import CorrectionError
from pointnetkl.simulation.depth_grid import GridError
from raw_survey import CRS, EAST, NORTH, Plan

PLAN = Plan()
ORIGIN = EAST + 7.0, NORTH - 3.0
BOUNDS = np.array([0.0, 0.0]), np.array([300.0, 100.0])


def stored(folder: Path, grid: Path, spacing_m: float = 2.0, crs: str = CRS) -> Reference:
    return reference.store(grid, crs, ORIGIN, BOUNDS, spacing_m, folder / "points.npy")


def changed(grid: Path, function: str = "same", **profile: object) -> Path:
    """Write a grid again, changed."""
    with rasterio.open(grid) as dataset:
        z, old = dataset.read(1), dataset.profile
    z = {"same": z, "down": -z, "empty": np.full_like(z, -9999.0)}[function]
    with rasterio.open(grid, "w", **{**old, **profile}) as dataset:
        dataset.write(z, 1)
    return grid


@pytest.fixture
def grid(tmp_path: Path) -> Path:
    return raw_survey.grid(tmp_path / "grid.tif", PLAN)


def everywhere(known: Reference) -> np.ndarray:
    return known(np.array([-1e5, -1e5]), np.array([1e5, 1e5]))


def off(points: np.ndarray) -> np.ndarray:
    """Return how far points (n, 3) lie above the seabed."""
    x, y, z = points.T
    return np.asarray(z - raw_survey.hills(x + ORIGIN[0] - EAST, y + ORIGIN[1] - NORTH))


def test_points_lie_on_the_seabed_at_the_middles_of_cells(tmp_path: Path, grid: Path):
    points = everywhere(stored(tmp_path, grid))
    assert np.abs(off(points)).max() < 1e-4
    assert (np.diff(points[:, 0]) >= 0).all()
    assert len(points) > 100 * 50


def test_a_rectangle_has_its_points_and_no_others(tmp_path: Path, grid: Path):
    known = stored(tmp_path, grid)
    low, high = np.array([50.0, 20.0]), np.array([90.0, 60.0])
    points, every = known(low, high), everywhere(known)
    inside = ((every[:, :2] >= low) & (every[:, :2] < high)).all(axis=1)
    assert len(points) == pytest.approx(20 * 20, abs=45)
    assert set(map(tuple, every[inside])) <= set(map(tuple, points))
    assert len(known(np.array([9e3, 9e3]), np.array([9.1e3, 9.1e3]))) == 0


def test_depths_and_heights_are_the_same_ground(tmp_path: Path, grid: Path):
    assert np.abs(off(everywhere(stored(tmp_path, changed(grid, "down"))))).max() < 1e-4


@pytest.mark.parametrize("spacing_m", [0.5, 2.0, 6.0])
def test_points_are_no_closer_than_the_survey_s(tmp_path: Path, grid: Path, spacing_m: float):
    x = np.unique(everywhere(stored(tmp_path, grid, spacing_m))[:, 0].round(3))
    assert np.diff(x).min() == pytest.approx(max(spacing_m, 2.0))


def test_cells_without_a_depth_are_no_points(tmp_path: Path, grid: Path):
    with rasterio.open(grid, "r+") as dataset:
        z = dataset.read(1)
        z[::2] = -9999.0
        dataset.write(z, 1)
    assert np.abs(off(everywhere(stored(tmp_path, grid)))).max() < 1e-4


def test_only_what_is_near_the_survey_is_kept(tmp_path: Path):
    wide = raw_survey.grid(tmp_path / "wide.tif", replace(PLAN, line_m=3000.0), cell_m=8.0, margin_m=500.0)
    points = everywhere(stored(tmp_path, wide))
    assert points[:, :2].min() > -110
    assert points[:, 0].max() < 410


def test_another_process_opens_the_same_file(tmp_path: Path, grid: Path):
    known = stored(tmp_path, grid)
    sent = pickle.dumps(known)
    assert len(sent) < 1000
    np.testing.assert_array_equal(everywhere(pickle.loads(sent)), everywhere(known))


@pytest.mark.parametrize("level_m", [-3.7, 0.0, 41.0])
def test_a_level_of_depths_that_differs_is_taken_out(tmp_path: Path, grid: Path, level_m: float):
    known = stored(tmp_path, grid)
    rng = np.random.default_rng(0)
    xy = rng.uniform([0, 0], [300, 100], (2000, 2))
    z = raw_survey.hills(*(xy + np.array(ORIGIN) - [EAST, NORTH]).T) + level_m
    z[:100] += 50.0  # outliers
    raised, shift = reference.levelled(known, np.column_stack([xy, z]), 2.0, tmp_path / "raised.npy")
    assert shift == pytest.approx(level_m, abs=0.05)
    assert np.median(off(everywhere(raised))) == pytest.approx(level_m, abs=0.05)


def test_a_survey_beside_the_grid_keeps_the_level(tmp_path: Path, grid: Path):
    known = stored(tmp_path, grid)
    raised, shift = reference.levelled(known, np.array([[5e3, 5e3, -1.0]]), 2.0, tmp_path / "raised.npy")
    assert (raised, shift) == (known, 0.0)


def test_a_grid_of_another_place_is_one_sentence(tmp_path: Path, grid: Path):
    far = np.array([5e4, 5e4]), np.array([6e4, 6e4])
    with pytest.raises(CorrectionError, match=r"^\S*grid\.tif: has no cell under the survey; is it of another place"):
        reference.store(grid, CRS, ORIGIN, far, 2.0, tmp_path / "a.npy")


def test_a_grid_without_depths_is_one_sentence(tmp_path: Path, grid: Path):
    with pytest.raises(CorrectionError, match=r"^\S*grid\.tif: has no depth under the survey"):
        stored(tmp_path, changed(grid, "empty"))


@pytest.mark.parametrize(("crs", "named"), [("EPSG:32634", "EPSG:32634"), (None, "no CRS")])
def test_a_grid_of_another_map_is_one_sentence(tmp_path: Path, grid: Path, crs: str | None, named: str):
    sentence = f"is in {named} and the survey in {CRS}; bring it to the survey's"
    with pytest.raises(CorrectionError, match=rf"^\S*grid\.tif: {re.escape(sentence)}$"):
        stored(tmp_path, changed(grid, crs=crs))


@pytest.mark.parametrize("content", [b"", b"II*\0", b"no grid at all"])
def test_what_is_no_grid_is_one_sentence(tmp_path: Path, content: bytes):
    (tmp_path / "a.tif").write_bytes(content)
    with pytest.raises(GridError, match="is not a GeoTIFF or BAG") as ended:
        stored(tmp_path, tmp_path / "a.tif")
    assert "\n" not in str(ended.value)
