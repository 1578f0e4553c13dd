"""Consistency maps: each cell's error where it is on the earth, and the same file every time."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio

from pointnetkl.slam.benchmark import schemas as slam_schemas
from pointnetkl.slam.consistency import consistency_map, map_to_map
from pointnetkl.slam.consistency.consistency_map import Cells, Frame
from pointnetkl.surveys import pose, survey
from pointnetkl.workflow import artifacts

FRAME = Frame((650_000.0, 6_450_000.0), "EPSG:32632", 15.0)
GT = Cells(np.array([-2, 3]), np.array([1, -4]), np.array([0.5, 2.5]))
NETWORK = Cells(np.array([0]), np.array([0]), np.array([1.5]))


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "maps" / "mine_consistency.tif"
    consistency_map.write(path, {"gt": GT, "network": NETWORK}, FRAME, {"survey": "mine"})
    return path


def test_a_geotiff_has_each_error_at_its_easting_and_northing(written: Path):
    with rasterio.open(written) as file:
        for band, cells in ((1, GT), (2, NETWORK)):
            east = FRAME.origin[0] + (cells.column + 0.5) * 15.0
            north = FRAME.origin[1] + (cells.row + 0.5) * 15.0
            values = [value[0] for value in file.sample(list(zip(east, north, strict=True)), band)]
            np.testing.assert_array_equal(values, cells.error_m.astype(np.float32))
            assert np.isfinite(file.read(band)).sum() == len(cells.row)


def test_a_geotiff_says_where_it_is_what_its_bands_are_and_in_what_unit(written: Path):
    with rasterio.open(written) as file:
        assert file.crs.to_epsg() == 32632
        assert file.transform == rasterio.Affine(15, 0, 650_000 - 30, 0, -15, 6_450_000 + 30)
        assert (file.descriptions, file.units) == (("gt", "network"), ("m", "m"))
        assert np.isnan(file.nodata)
        assert file.dtypes == ("float32", "float32")
        assert '"survey": "mine"' in file.tags()["pointnetkl"]


def test_equal_maps_are_equal_bytes(written: Path):
    before = written.read_bytes()
    consistency_map.write(written, {"gt": GT, "network": NETWORK}, FRAME, {"survey": "mine"})
    assert written.read_bytes() == before
    assert [path.name for path in written.parent.iterdir()] == [written.name]


def test_rasters_are_read_as_they_were_written(written: Path):
    rasters = consistency_map.read(written, ("truth", "network", "gt"))
    assert list(rasters.errors) == ["network", "gt"]
    assert rasters.extent == (649_970.0, 650_060.0, 6_449_940.0, 6_450_030.0)
    extent = consistency_map.extent([GT, NETWORK])
    np.testing.assert_array_equal(rasters.errors["gt"], consistency_map.raster(GT, extent))


def test_north_is_up(written: Path):
    image = consistency_map.read(written, ("gt",)).errors["gt"]
    assert np.argwhere(np.isfinite(image)).tolist() == [[0, 0], [5, 5]]


def test_a_map_without_overlap_is_one_empty_cell(tmp_path: Path):
    nothing = Cells(*(np.empty(0, np.int64) for _ in range(2)), np.empty(0))
    consistency_map.write(tmp_path / "none.tif", {"gt": nothing}, FRAME, {})
    assert np.isnan(consistency_map.read(tmp_path / "none.tif", ("gt",)).errors["gt"]).tolist() == [[True]]


def test_a_survey_of_an_unknown_place_has_a_local_map(tmp_path: Path):
    consistency_map.write(tmp_path / "local.tif", {"gt": GT}, Frame((0.0, 0.0), "local", 15.0), {})
    with rasterio.open(tmp_path / "local.tif") as file:
        assert not file.crs.is_projected
        assert "local" in file.crs.to_wkt()
        assert file.bounds.left == -30.0


def test_an_unknown_crs_is_refused_in_a_sentence(tmp_path: Path):
    with pytest.raises(consistency_map.ConsistencyError, match="'EPSG:1' is unknown"):
        consistency_map.write(tmp_path / "lost.tif", {"gt": GT}, Frame((0.0, 0.0), "EPSG:1", 15.0), {})


def test_poses_that_are_lost_do_not_fill_the_memory(tmp_path: Path):
    lost = Cells(np.array([0, 10**9]), np.array([0, 10**9]), np.ones(2))
    with pytest.raises(consistency_map.ConsistencyError, match="poses are lost"):
        consistency_map.write(tmp_path / "lost.tif", {"gt": lost}, FRAME, {})


def test_what_is_no_geotiff_is_refused_in_a_sentence(tmp_path: Path):
    (tmp_path / "mine.tif").write_bytes(b"none")
    with pytest.raises(consistency_map.ConsistencyError, match=r"mine\.tif: is not a GeoTIFF"):
        consistency_map.read(tmp_path / "mine.tif", ("gt",))


def test_a_trajectory_of_the_table_has_the_cells_of_its_poses():
    rng = np.random.default_rng(0)
    clouds = [rng.uniform(0, 40, (300, 3)) for _ in range(3)]
    xyz, yaw = rng.uniform(0, 30, (3, 3)), rng.uniform(-3, 3, 3)
    columns = dict(zip(("x_m", "y_m", "z_m"), xyz.T, strict=True))
    rows = pd.DataFrame({"survey": "mine", "which": "gt", "submap": range(3), **columns, "yaw_rad": yaw})
    shuffled = rows.iloc[[2, 0, 1]][slam_schemas.TRAJECTORIES.names]
    measure = map_to_map.MapToMap(clouds, 15.0, 2)
    cells = consistency_map.cells_by_trajectory(shuffled, measure.cells)
    expected = measure.cells(np.array([pose.matrix(p, a) for p, a in zip(xyz, yaw, strict=True)]))
    np.testing.assert_array_equal(cells["gt"].error_m, expected.error_m)


def test_a_map_frame_is_what_the_pings_say(tmp_path: Path):
    pings = survey.PINGS.empty_table().to_pandas()
    artifacts.write_table(tmp_path / "pings.parquet", pings, survey.PINGS, {"origin": [1.0, 2.0], "crs": "local"})
    assert consistency_map.read_origin(tmp_path / "pings.parquet") == ((1.0, 2.0), "local")


def test_pings_of_nowhere_are_refused_in_a_sentence(tmp_path: Path):
    artifacts.write_table(tmp_path / "pings.parquet", survey.PINGS.empty_table().to_pandas(), survey.PINGS, {})
    with pytest.raises(consistency_map.ConsistencyError, match="must name the crs"):
        consistency_map.read_origin(tmp_path / "pings.parquet")
