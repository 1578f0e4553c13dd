"""track.csv and closures.csv, read by pandas and the standard library."""

import csv
import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pyproj import Geod, Proj, Transformer

import corrected_survey
from pointnetkl.correction.products import placed, tables
from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import CLOSURES, Corrected, CorrectionError


def track_of(path: Path, survey: Corrected) -> pd.DataFrame:
    tables.write_track(path / "track.csv", Placed(survey))
    return pd.read_csv(path / "track.csv")


def test_a_line_per_ping_has_the_corrected_place_on_the_map_and_on_the_earth(tmp_path: Path):
    survey = corrected_survey.corrected(heads=2)
    table, after = track_of(tmp_path, survey), corrected_survey.after(survey.track)
    assert len(table) == len(survey.track)
    east, north = after[:, 0] + survey.origin[0], after[:, 1] + survey.origin[1]
    np.testing.assert_allclose(table["x_m"], east, atol=6e-5)
    np.testing.assert_allclose(table["y_m"], north, atol=6e-5)
    again = Transformer.from_crs("EPSG:4326", survey.crs, always_xy=True).transform(table["lon_deg"], table["lat_deg"])
    np.testing.assert_allclose(again, [east, north], atol=2e-5)
    np.testing.assert_allclose(table["before_x_m"], survey.track["x_m"] + survey.origin[0], atol=6e-5)
    np.testing.assert_allclose(table["x_m"] - table["before_x_m"], table["moved_x_m"], atol=2e-4)
    np.testing.assert_allclose(table["depth_m"], -survey.track["z_m"], atol=6e-5)
    np.testing.assert_allclose(table["sigma_x_m"] ** 2, survey.track["var_xx_m2"], atol=1e-4)
    np.testing.assert_allclose(
        table["correlation_xy"] * table["sigma_x_m"] * table["sigma_y_m"], survey.track["var_xy_m2"], atol=1e-4
    )
    np.testing.assert_allclose(table["before_sigma_y_m"] ** 2, survey.track["before_var_yy_m2"], atol=1e-3)
    np.testing.assert_allclose(table["sigma_heading_deg"], np.rad2deg(np.sqrt(1e-5)), atol=1e-6)


def test_headings_are_from_true_north_where_the_map_has_a_place(tmp_path: Path):
    survey = corrected_survey.corrected()
    table, after = track_of(tmp_path, survey), corrected_survey.after(survey.track)
    # a step along the corrected yaw on the map, as an azimuth on the ellipsoid
    ahead = after[:, :2] + 10.0 * np.column_stack([np.cos(after[:, 2]), np.sin(after[:, 2])]) + survey.origin
    to_earth = Transformer.from_crs(survey.crs, "EPSG:4326", always_xy=True)
    azimuth, _, _ = Geod(ellps="WGS84").inv(table["lon_deg"], table["lat_deg"], *to_earth.transform(*ahead.T))
    apart = np.mod(table["heading_deg"] - azimuth + 180, 360) - 180
    assert np.abs(apart).max() < 1e-3
    convergence = Proj(survey.crs).get_factors(table["lon_deg"][0], table["lat_deg"][0]).meridian_convergence
    grid = 90 - np.rad2deg(after[0, 2])
    assert table["heading_deg"][0] == pytest.approx(grid + convergence, abs=1e-3)
    assert abs(convergence) > 1.0


def test_a_local_map_has_grid_headings_and_no_longitude(tmp_path: Path):
    survey = corrected_survey.corrected("local")
    table = track_of(tmp_path, survey)
    assert table["lon_deg"].isna().all()
    assert table["lat_deg"].isna().all()
    yaw = corrected_survey.after(survey.track)[:, 2]
    np.testing.assert_allclose(table["heading_deg"], np.mod(90 - np.rad2deg(yaw), 360), atol=1e-6)
    np.testing.assert_allclose(table["moved_heading_deg"], -np.rad2deg(survey.track["moved_yaw_rad"]), atol=1e-6)


def test_times_are_utc_with_microseconds(tmp_path: Path):
    survey = corrected_survey.corrected(heads=2)
    tables.write_track(tmp_path / "track.csv", Placed(survey))
    with (tmp_path / "track.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["utc"] == "2017-07-14T02:40:00.250000Z"
    for row, time in zip(rows, survey.track["time_s"], strict=True):
        assert datetime.datetime.fromisoformat(row["utc"]).timestamp() == pytest.approx(time, abs=1e-6)
        assert float(row["time_s"]) == pytest.approx(time, abs=1e-6)
    assert all(len(row["utc"]) == 27 for row in rows)


def test_what_is_not_known_is_empty(tmp_path: Path):
    survey = corrected_survey.corrected()
    unknown = corrected_survey.with_track(survey, var_yaw_rad2=np.nan, before_var_xx_m2=np.nan, file=None)
    table = track_of(tmp_path, unknown)
    assert table[["sigma_heading_deg", "before_sigma_x_m", "file"]].isna().all(axis=None)
    assert table["before_sigma_y_m"].notna().all()


def test_a_track_of_submaps_without_times_has_a_count_and_no_utc(tmp_path: Path):
    table = track_of(tmp_path, corrected_survey.of_submaps())
    assert table["utc"].isna().all()
    assert table["time_s"].tolist() == list(range(9))


def test_a_name_with_commas_and_quotes_comes_back(tmp_path: Path):
    survey = corrected_survey.with_track(corrected_survey.corrected(), file='a, "b".all')
    assert set(track_of(tmp_path, survey)["file"]) == {'a, "b".all'}


def test_closures_have_a_line_each_with_places_of_the_earth(tmp_path: Path):
    survey = corrected_survey.corrected()
    tables.write_closures(tmp_path / "closures.csv", survey)
    table = pd.read_csv(tmp_path / "closures.csv", dtype={"targets": str})
    assert set(table.columns) == {*CLOSURES.names, "lon_deg", "lat_deg"}
    assert table["state"].tolist() == survey.closures["state"].tolist()
    assert table["targets"].fillna("").tolist() == survey.closures["targets"].tolist()
    np.testing.assert_allclose(table["x_m"], survey.closures["x_m"] + survey.origin[0], atol=6e-5)
    to_map = Transformer.from_crs("EPSG:4326", survey.crs, always_xy=True)
    np.testing.assert_allclose(to_map.transform(table["lon_deg"], table["lat_deg"])[1], table["y_m"], atol=1e-4)
    for name in ("shift_x_m", "v_xy_m2", "time_s", "target_time_s", "sigmas_after"):
        np.testing.assert_allclose(table[name], survey.closures[name].astype(float), atol=1e-8, rtol=1e-14)


def test_a_survey_without_closures_has_their_header(tmp_path: Path):
    survey = corrected_survey.without_closures()
    tables.write_closures(tmp_path / "closures.csv", survey)
    assert len(pd.read_csv(tmp_path / "closures.csv")) == 0


def test_an_unknown_coordinate_system_is_one_sentence():
    with pytest.raises(CorrectionError, match=r"cannot be placed on the earth by EPSG:1 "):
        placed.on_earth("EPSG:1", np.zeros((1, 2)))


def test_velocities_do_not_reach_over_gaps():
    track = Placed(corrected_survey.corrected("local"))
    speed = np.hypot(*track.velocity[:, :2].T)
    np.testing.assert_allclose(speed, corrected_survey.SPEED_M_S, atol=0.01)
