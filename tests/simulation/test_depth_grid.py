"""Real grids: GeoTIFF and BAG, what they hold, and what of them is refused before it costs memory."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.transform import from_origin

from damage import corrupted
from grid_files import RAMP, bag, geotiff
from pointnetkl import simulation
from pointnetkl.inspection import grids
from pointnetkl.simulation import depth_grid, grid
from pointnetkl.simulation.depth_grid import GridError
from realdata import REALDATA
from simulated_survey import georeferenced, quiet_vehicle, sail, short_line

BERING, SCITUATE = (REALDATA / "grid" / name for name in ("bering_strait_2m.bag", "scituate_5m.tif"))
real = pytest.mark.skipif(not BERING.exists(), reason="no real data here")


@pytest.mark.parametrize("write", [geotiff, bag])
def test_a_grid_is_described_and_read_alike_in_either_format(tmp_path: Path, write):
    path = write(tmp_path / ("a.bag" if write is bag else "a.tif"))
    held = depth_grid.describe(path)
    assert (held.format, held.rows, held.columns) == ("BAG" if write is bag else "GeoTIFF", 60, 80)
    assert (held.cell_m, held.crs, held.valid, held.variable) == (
        (2.0, 2.0),
        "EPSG:32632",
        4800,
        False,
    )
    assert (held.depth_min_m, held.depth_max_m) == pytest.approx((50.0, 56.69), abs=1e-4)
    assert depth_grid.begins(path.read_bytes()[:4096])
    terrain = grid.read(path)
    assert terrain.crs == "EPSG:32632"
    assert terrain(np.array([1081.0]), np.array([1939.0]))[0] == pytest.approx(RAMP[30, 40], abs=1e-3)


def test_a_description_does_not_depend_on_its_stripes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    z = RAMP.copy()
    z[10:30, :50] = -9999
    path = geotiff(tmp_path / "a.tif", -z * (z > -9999) - 9999 * (z == -9999), tiled=True, blockxsize=16, blockysize=16)
    held = depth_grid.describe(path)
    monkeypatch.setattr(depth_grid, "_STRIPE", 100)
    assert depth_grid.describe(path) == held
    assert held.valid == 3800
    assert (held.depth_min_m, held.depth_max_m) == pytest.approx((50.0, 56.69), abs=1e-4)  # positive depths


LAND = np.where(RAMP > -54, RAMP + 90, RAMP)  # mostly 36 to 40 m high, and a sea of 54 to 57 m


@pytest.mark.parametrize(
    ("z", "crs", "down", "told"),
    [
        (LAND, "EPSG:32632", False, "taken as height, because 39.2 % of its numbers are below zero"),
        (-RAMP, "EPSG:32632", True, "taken as depth, because 0 % of its numbers are below zero"),
        (np.where(RAMP > -50.1, 1.5, -RAMP), "EPSG:32632", True, "taken as depth"),
        (np.where(RAMP > -50.1, -1.5, -RAMP), "EPSG:32632", True, "taken as depth"),  # ground that dries
        (RAMP, "EPSG:32632", False, "taken as height, because 100 % of"),
        (-RAMP, "EPSG:32632+5703", False, "NAVD88 height"),
        (LAND, "EPSG:32632+5715", True, "MSL depth"),
    ],
)
@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_whether_numbers_are_depths_is_one_answer_for_all_that_read_a_grid(
    tmp_path: Path, z: np.ndarray, crs: str, down: bool, told: str, version: str
):
    path = geotiff(tmp_path / "a.tif", z, crs=crs, GEOTIFF_VERSION=version)
    depth = z if down else -z
    held = depth_grid.describe(path)
    assert (held.depth_min_m, held.depth_max_m) == pytest.approx((depth.min(), depth.max()), abs=1e-4)
    assert held.vertical.startswith(told)
    seabed = grid.read(path)
    assert (held.crs, seabed.crs) == ("EPSG:32632", "EPSG:32632")
    assert seabed(np.array([1081.0]), np.array([1891.0]))[0] == pytest.approx(-depth[54, 40], abs=1e-3)
    terrain = grids.inspect(path)
    assert (terrain.facts.vertical, terrain.drawing.cells.depth_m[5, 40]) == (
        held.vertical,
        pytest.approx(depth[54, 40]),
    )


def test_a_bag_has_heights_also_of_a_lake(tmp_path: Path):
    path = bag(tmp_path / "a.bag", z=RAMP + 200)
    held = depth_grid.describe(path)
    assert (held.depth_min_m, held.depth_max_m) == pytest.approx((-150, -143.31), abs=1e-4)
    assert held.vertical.endswith("as in every BAG")
    assert grid.read(path)(np.array([1081.0]), np.array([1939.0]))[0] == pytest.approx(RAMP[30, 40] + 200, abs=1e-3)


def test_stored_scales_and_offsets_are_applied(tmp_path: Path):
    path = geotiff(tmp_path / "a.tif", np.round((RAMP + 50) * 100), dtype="int16")
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = [0.01], [-50.0]
    held = depth_grid.describe(path)
    assert (held.depth_min_m, held.depth_max_m) == pytest.approx((50.0, 56.69), abs=1e-6)


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"crs": "EPSG:4326"}, "its CRS is WGS 84, must be projected"),
        ({"crs": "EPSG:2263"}, "must be projected, in metres"),
        ({"crs": None}, "its CRS is None"),
        ({"transform": from_origin(1000, 2000, 2, 2) @ rasterio.Affine.rotation(10)}, "is rotated"),
        ({"z": np.where(RAMP > -51, -32768, RAMP)}, "are beyond 12 km, such as -32768"),
        ({"z": np.full((60, 80), -9999.0)}, "has no depths"),
    ],
)
def test_what_is_no_map_of_depths_in_metres_is_refused(tmp_path: Path, how: dict, told: str):
    with pytest.raises(GridError, match=told) as caught:
        grid.read(geotiff(tmp_path / "a.tif", **how))
    assert "\n" not in str(caught.value)


def test_depths_in_feet_are_refused(tmp_path: Path):
    path = geotiff(tmp_path / "a.tif")
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ["ft"]
    with pytest.raises(GridError, match="its depths are in ft"):
        grid.read(path)


def test_a_bag_of_variable_resolution_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = bag(tmp_path / "a.bag")
    monkeypatch.setattr(depth_grid, "is_variable", lambda dataset: True)
    assert depth_grid.describe(path).variable
    with pytest.raises(GridError, match="is a BAG of variable resolution"):
        grid.read(path)


def test_other_rasters_are_refused_even_where_the_library_reads_them(tmp_path: Path):
    rasterio.shutil.copy(geotiff(tmp_path / "a.tif"), tmp_path / "a.vrt", driver="VRT")
    with pytest.raises(GridError, match="by its first bytes it is another file"):
        grid.read(tmp_path / "a.vrt")


def test_of_a_huge_grid_no_more_than_the_part_about_the_centre_is_read(tmp_path: Path):
    path = tmp_path / "a.tif"
    huge = {"crs": "EPSG:32632", "transform": from_origin(0, 400_000, 2, 2), "dtype": "float32", "sparse_ok": True}
    huge |= {"height": 200_000, "width": 200_000, "count": 1, "tiled": True, "bigtiff": "yes", "nodata": -9999}
    with rasterio.open(path, "w", driver="GTiff", **huge) as dataset:
        dataset.write(RAMP.astype("float32"), 1, window=rasterio.windows.Window(90_000, 120_000, 80, 60))
    with pytest.raises(GridError, match="200000 x 200000 cells, more than"):
        grid.read(path)
    x, y = 180_081.0, 159_939.0
    terrain = grid.read(path, centre=(x, y))
    assert terrain.valid.size <= 1 << 24
    assert terrain.valid.sum() == 4800
    assert terrain(np.array([x]), np.array([y]))[0] == pytest.approx(RAMP[30, 40], abs=1e-3)
    with pytest.raises(GridError, match="lies outside it"):
        grid.read(path, centre=(-5.0, 100.0))


@real
def test_the_real_grids_are_described():
    held = depth_grid.describe(BERING)
    assert (held.format, held.rows, held.columns, held.crs) == (
        "BAG",
        1478,
        1707,
        "EPSG:32602",
    )
    assert held.valid * 4 / 1e6 == pytest.approx(4.63, abs=0.01)  # km2
    assert held.depth_max_m - held.depth_min_m == pytest.approx(2.0, abs=0.1)
    held = depth_grid.describe(SCITUATE)
    assert (held.format, held.rows, held.columns, held.crs) == (
        "GeoTIFF",
        661,
        1125,
        "EPSG:32619",
    )
    assert (held.depth_min_m, held.depth_max_m) == pytest.approx((6.4, 29.9), abs=0.06)


@real
def test_a_survey_over_the_real_bag_has_its_depths():
    layout = dataclasses.replace(short_line().layout, lines=2, line_length_m=300.0, azimuth_deg=20.0)
    settings = short_line(grid=str(BERING), centre_m=[], altitude_m=20.0, layout=layout)
    terrain = simulation.ground(settings)
    placed = georeferenced(sail(settings, quiet_vehicle(), terrain)[0])
    assert placed[:, 2] == pytest.approx(terrain(placed[:, 0], placed[:, 1]), abs=0.1)
    assert -53.0 < placed[:, 2].min() < placed[:, 2].max() < -50.9


@pytest.mark.parametrize("write", [geotiff, bag])
def test_mutated_grids_end_in_a_sentence_or_in_depths_of_a_sea(tmp_path: Path, write):
    path = write(tmp_path / ("a.bag" if write is bag else "a.tif"))
    content = path.read_bytes()
    rng = np.random.default_rng(8)
    for _ in range(60):
        path.write_bytes(corrupted(content, rng))
        try:
            held = depth_grid.describe(path)
        except GridError as error:
            sentence = str(error)
            assert "\n" not in sentence
        else:
            assert not held.valid or held.depth_max_m <= 12_000
