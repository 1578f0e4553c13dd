"""Simulated surveys: terrain that knows no extent, soundings where they belong, navigation that drifts."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio
import yaml
from hypothesis import given
from hypothesis import settings as trials
from hypothesis import strategies as st
from rasterio.transform import from_origin

from pointnetkl import simulation
from pointnetkl.simulation import grid, noise, seabed, sonar, vehicle
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError
from realdata import REALDATA
from simulated_survey import PARAMS, georeferenced, quiet_vehicle, sail, short_line

SCITUATE = REALDATA / "grid/scituate_5m.tif"


class Plane:
    """A seabed that is a plane."""

    crs = "EPSG:32632"

    def __init__(self, depth_m: float = 50.0, slope_x: float = 0.0, slope_y: float = 0.0) -> None:
        self.depth_m, self.slope_x, self.slope_y = depth_m, slope_x, slope_y

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return -self.depth_m + self.slope_x * x + self.slope_y * y

    def place(self, length_m: float, width_m: float, azimuth_rad: float) -> tuple[float, float]:
        return 0.0, 0.0


def hugin() -> vehicle.Settings:
    """Return the Hugin of params.yaml as it is."""
    return parameters.read(PARAMS, "vehicles.hugin", vehicle.Settings)


def test_the_same_seed_gives_the_same_survey():
    first, second = (sail(short_line(), hugin(), simulation.ground(short_line())) for _ in range(2))
    pd.testing.assert_frame_equal(first[0], second[0], check_exact=True)
    pd.testing.assert_frame_equal(first[1], second[1], check_exact=True)


def test_another_seed_gives_another_seabed():
    x = np.linspace(0, 500, 50)
    heights = [seabed.heights(short_line().terrain, seed, x, x) for seed in (1, 2)]
    assert np.abs(heights[0] - heights[1]).max() > 0.1


@trials(deadline=None, max_examples=20)
@given(st.floats(-5e4, 5e4), st.floats(-5e4, 5e4), st.integers(0, 40))
def test_terrain_at_a_point_does_not_depend_on_what_else_is_asked(x: float, y: float, others: int):
    terrain, along = short_line().terrain, np.linspace(-3e4, 3e4, others)
    alone = seabed.heights(terrain, 3, np.array([x]), np.array([y]))
    among = seabed.heights(terrain, 3, np.append(along, x), np.append(along[::-1], y))
    assert among[-1] == alone[0]


@pytest.mark.parametrize("octaves", [1, 3])
def test_a_random_field_has_the_variance_and_the_slope_that_it_says(octaves: int):
    x, y = np.random.default_rng(0).uniform(-1e5, 1e5, (2, 200_000))
    field, step = noise.field(x, y, 7, 30.0, octaves), 0.01
    slope = (noise.field(x + step, y, 7, 30.0, octaves) - field) / step
    assert field.mean() == pytest.approx(0, abs=0.02)
    assert field.std() == pytest.approx(1, rel=0.02)
    assert slope.std() == pytest.approx(noise.slope(30.0, octaves), rel=0.02)


def test_terrain_is_patchy():
    field = seabed.Field(slope=[0.001, 0.1], length_m=20.0)
    none = seabed.Field(slope=[1e-9, 1e-9], length_m=20.0)
    terrain = seabed.Settings(50.0, 500.0, seabed.Relief(0.0, 500.0, 0.5, 1.0, 0.0), none, field)
    corner = np.random.default_rng(1).uniform(-2e4, 2e4, (2, 200, 1))
    x, y = corner + np.random.default_rng(2).uniform(0, 60, (2, 200, 100))
    rough = seabed.heights(terrain, 1, x.ravel(), y.ravel()).reshape(200, 100).std(axis=1)
    assert np.quantile(rough, 0.9) > 10 * np.quantile(rough, 0.1)


def test_a_ping_on_flat_seabed_is_flat_whatever_the_attitude():
    swaying = dataclasses.replace(quiet_vehicle(), attitude=vehicle.Attitude(5.0, 4.0, 3.0, 9.0, 0.0, 2.0))
    raw, truth = sail(short_line(), swaying, Plane(50.0))
    assert raw["down_m"].to_numpy() == pytest.approx(30.0, abs=0.02)
    assert georeferenced(raw)[:, 2] == pytest.approx(-50.0, abs=0.02)
    assert truth["z_m"].to_numpy() == pytest.approx(-20.0)
    assert np.abs(raw["roll_rad"]).max() > 0.02  # it did sway


@pytest.mark.parametrize("azimuth_deg", [0.0, 70.0, 200.0])
def test_port_is_left_of_the_course_and_starboard_right(azimuth_deg: float):
    layout = dataclasses.replace(short_line().layout, azimuth_deg=azimuth_deg)
    plane = Plane(100.0, 0.2, -0.1)
    raw, _ = sail(short_line(layout=layout), quiet_vehicle(), plane)
    placed = georeferenced(raw)
    assert placed[:, 2] == pytest.approx(plane(placed[:, 0], placed[:, 1]), abs=0.05)
    course = np.deg2rad(azimuth_deg)
    to_port = np.cos(course) * placed[:, 1] - np.sin(course) * placed[:, 0]
    assert np.all(to_port[raw["across_m"] < -1] > 0)
    assert np.all(to_port[raw["across_m"] > 1] < 0)
    assert np.all(np.diff(raw["across_m"][raw["time_s"] == raw["time_s"][0]]) > 0)  # beam 0 is to port


def test_lines_run_back_and_forth():
    layout = dataclasses.replace(short_line().layout, lines=3)
    _, truth = sail(short_line(layout=layout), quiet_vehicle(), Plane())
    assert np.unique(np.abs(truth["yaw_rad"]).round(6)).tolist() == pytest.approx([0.0, np.pi], abs=1e-5)
    assert np.all(np.diff(truth["time_s"]) > 0)
    assert np.diff(truth["time_s"]).max() * quiet_vehicle().speed_mps == pytest.approx(
        40 * np.pi / 2, rel=0.1
    )  # a turn


def test_noise_grows_outwards_and_not_with_altitude():
    spread = {}
    for altitude in (30.0, 60.0):
        raw, _ = sail(short_line(altitude_m=altitude), quiet_vehicle(noise_m=0.1, noise_growth=2.0), Plane(90.0))
        off = raw["down_m"] - altitude
        outer = np.abs(raw["across_m"]) > 0.9 * np.abs(raw["across_m"]).max()
        inner = np.abs(raw["across_m"]) < 0.1 * np.abs(raw["across_m"]).max()
        spread[altitude] = off[inner].std(), off[outer].std()
    assert spread[30.0][1] > 1.2 * spread[30.0][0]
    assert spread[60.0] == pytest.approx(spread[30.0], rel=0.15)
    assert spread[30.0][0] == pytest.approx(0.1, rel=0.1)


def test_dropouts_and_outliers_have_their_shares():
    full, _ = sail(short_line(), quiet_vehicle(), Plane())
    raw, _ = sail(short_line(), quiet_vehicle(dropouts=0.2, outliers=0.1, outlier_m=3.0, flagged=0.5), Plane())
    assert len(raw) == pytest.approx(0.8 * len(full), rel=0.03)
    assert (raw["quality"] == 1).mean() == pytest.approx(0.05, rel=0.25)
    assert full["quality"].max() == 0


def test_a_beam_ends_on_the_seabed_however_steep():
    plane, angle = Plane(100.0, 0.0, 0.9), np.arctan(np.linspace(-1.5, 1.5, 61))
    down = np.column_stack([np.zeros(61), np.sin(angle), -np.cos(angle)])
    ranges = sonar.cast(plane, np.tile([0.0, 0.0, -40.0], (61, 1)), down, np.full(61, 200.0))
    hit = np.isfinite(ranges)
    expected = 60.0 / (np.cos(angle) + 0.9 * np.sin(angle))
    assert ranges[hit] == pytest.approx(expected[hit], abs=0.05)
    assert not hit[(expected > 200) | (expected < 0)].any()
    assert hit[(expected > 0) & (expected < 199)].all()


def test_navigation_starts_at_the_truth_and_drifts():
    settings = parameters.read(PARAMS, "simulate.thwaites_11", simulation.Settings)
    lines = vehicle.lines(settings.layout, np.random.default_rng(0))
    track = vehicle.sail(lines, 0.0, 3.0, 60.0, hugin(), Plane(100.0), np.random.default_rng(1))
    x, y, _ = vehicle.dead_reckoned(track, hugin().navigation, np.random.default_rng(2))
    error = np.hypot(x - track.x, y - track.y)
    assert error[0] == 0
    assert 0.5 < error[-1] < 50
    assert np.diff(error).max() < 5  # turns included: it walks and does not jump


def test_no_two_surveys_share_a_seed():
    seeds = [survey["seed"] for survey in yaml.safe_load(PARAMS.read_text())["simulate"].values()]
    assert len(set(seeds)) == len(seeds)


def test_a_sonar_has_no_more_beams_than_it_has():
    with pytest.raises(sonar.SonarError, match="change beam_spacing_m or altitude_m"):
        sonar.angles(1000.0, 1.0, hugin().sonar)


def test_a_vehicle_does_not_fly_above_the_surface():
    with pytest.raises(vehicle.VehicleError, match="above the surface"):
        sail(short_line(altitude_m=30.0), quiet_vehicle(), Plane(20.0))


def test_a_patch_has_the_points_asked_for_and_is_centred():
    cloud = simulation.patch(short_line().terrain, 1234, 3.2, np.random.default_rng(0))
    assert cloud.shape == (1234, 3)
    assert cloud.mean(axis=0) == pytest.approx(0, abs=1e-9)
    length, width = np.ptp(cloud[:, :2], axis=0)
    assert length / width == pytest.approx(1.7, rel=0.1)
    assert length * width == pytest.approx(1234 * 3.2**2, rel=0.1)


def geotiff(path: Path, z: np.ndarray, cell: float = 2.0, crs: str = "EPSG:32632", nodata: float = -9999.0) -> Path:
    """Write heights, the first row the northernmost; the south-west corner lies at (1000, 2000)."""
    shape = {"height": z.shape[0], "width": z.shape[1], "count": 1, "dtype": "float64"}
    transform = from_origin(1000.0, 2000.0 + z.shape[0] * cell, cell, cell)
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=transform, nodata=nodata, **shape) as dataset:
        dataset.write(z, 1)
    return path


def plane_grid(path: Path, rows: int = 200, columns: int = 300) -> Path:
    """Write z = -50 + 0.1 (x - 1000) - 0.05 (y - 2000) at cell centres."""
    y = (rows - np.arange(rows) - 0.5)[:, None] * 2.0
    x = (np.arange(columns) + 0.5) * 2.0
    return geotiff(path, -70 + 0.1 * x - 0.05 * y)


def test_a_grid_gives_back_the_plane_that_was_written(tmp_path: Path):
    terrain = grid.read(plane_grid(tmp_path / "plane.tif"))
    x, y = np.random.default_rng(0).uniform([1010, 2010], [1590, 2390], (500, 2)).T
    assert terrain(x, y) == pytest.approx(-70 + 0.1 * (x - 1000) - 0.05 * (y - 2000), abs=0.01)
    assert terrain.crs == "EPSG:32632"


def test_roughness_below_the_cell_has_the_stated_amplitude(tmp_path: Path):
    smooth, rough = (grid.read(plane_grid(tmp_path / "plane.tif"), amplitude) for amplitude in (0.0, 0.3))
    x, y = np.random.default_rng(0).uniform([1010, 2010], [1590, 2390], (20_000, 2)).T
    assert (rough(x, y) - smooth(x, y)).std() == pytest.approx(0.3, rel=0.1)


def test_a_survey_over_a_grid_lies_in_its_valid_area(tmp_path: Path):
    z = np.full((200, 300), -60.0)
    z[:, :120] = -9999.0  # the western part is unknown
    path = geotiff(tmp_path / "half.tif", z)
    settings = short_line(
        grid=str(path), centre_m=[], layout=dataclasses.replace(short_line().layout, azimuth_deg=30.0)
    )
    raw, _ = sail(settings, quiet_vehicle(), simulation.ground(settings))
    placed = georeferenced(raw)
    assert placed[:, 0].min() > 1000 + 240
    assert len(raw) == len(sail(settings, quiet_vehicle(), Plane(60.0))[0])  # no beam fell off the edge


def test_a_survey_that_does_not_fit_is_refused_in_one_sentence(tmp_path: Path):
    settings = short_line(
        grid=str(plane_grid(tmp_path / "plane.tif")),
        centre_m=[],
        layout=dataclasses.replace(short_line().layout, line_length_m=2000.0),
    )
    with pytest.raises(grid.GridError, match="has no room for a survey of"):
        sail(settings, quiet_vehicle(), simulation.ground(settings))


@pytest.mark.parametrize("content", [b"this is not a grid", b"II*\0" + bytes(200), bytes(10)])
def test_a_file_that_is_no_geotiff_is_refused_in_one_sentence(tmp_path: Path, content: bytes):
    path = tmp_path / "broken.tif"
    path.write_bytes(content)
    with pytest.raises(grid.GridError, match=r"broken\.tif"):
        grid.read(path)


def test_a_grid_in_degrees_is_refused(tmp_path: Path):
    with pytest.raises(grid.GridError, match="must be projected"):
        grid.read(geotiff(tmp_path / "degrees.tif", np.full((9, 9), -5.0), crs="EPSG:4326"))


def test_a_grid_that_is_not_there_is_named():
    with pytest.raises(PointNetKLError, match=r"nowhere\.tif"):
        simulation.ground(short_line(grid="nowhere.tif"))


@pytest.mark.skipif(not SCITUATE.exists(), reason="real data are not here")
def test_a_survey_over_a_real_grid_has_its_depths():
    layout = dataclasses.replace(short_line().layout, lines=2, line_length_m=200.0, azimuth_deg=20.0)
    settings = short_line(grid=str(SCITUATE), centre_m=[], altitude_m=5.0, layout=layout)
    terrain = simulation.ground(settings)
    assert terrain.crs == "EPSG:32619"
    placed = georeferenced(sail(settings, quiet_vehicle(), terrain)[0])
    assert placed[:, 2] == pytest.approx(terrain(placed[:, 0], placed[:, 1]), abs=0.1)
    assert placed[:, 2].min() > -30
    assert placed[:, 2].max() < -6


def test_a_sunken_grid_lies_so_much_deeper_and_is_else_the_same(tmp_path: Path):
    path = plane_grid(tmp_path / "plane.tif")
    x, y = np.random.default_rng(0).uniform([1010, 2010], [1590, 2390], (50, 2)).T
    np.testing.assert_allclose(grid.read(path, sunk_m=100.0)(x, y), grid.read(path)(x, y) - 100.0, atol=1e-9)


def test_a_survey_over_a_grid_may_say_where_its_middle_is(tmp_path: Path):
    path = str(plane_grid(tmp_path / "plane.tif"))
    terrain = simulation.ground(short_line(grid=path, centre_m=[1250.0, 2200.0]))
    assert terrain.place(200.0, 100.0, 0.3) == (1250.0, 2200.0)
    with pytest.raises(
        grid.GridError, match="has no depth under a part of a survey of 200 m by 100 m about 1050, 2200"
    ):
        simulation.ground(short_line(grid=path, centre_m=[1050.0, 2200.0])).place(200.0, 100.0, 0.3)
    with pytest.raises(simulation.SimulationError, match=r"must be \[easting, northing\]"):
        simulation.ground(short_line(grid=path, centre_m=[1050.0]))
