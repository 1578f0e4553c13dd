"""lines.gpkg, read by sqlite3 with its geometries unpacked by hand, and by pyogrio."""

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pyogrio
import pytest

import corrected_survey
from pointnetkl.correction.products import lines
from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import Corrected

BOUNDS = {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}  # bytes of a GeoPackage header's envelope, by its kind


def written(path: Path, survey: Corrected) -> Path:
    file = path / "lines.gpkg"
    lines.write(file, survey, Placed(survey))
    return file


def rows_of(file: Path, sql: str) -> list[tuple]:
    with closing(sqlite3.connect(file)) as database:
        return database.execute(sql).fetchall()


def vertices(blob: bytes) -> np.ndarray:
    """Return the vertices of a geometry of a GeoPackage, and check its header."""
    assert blob[:2] == b"GP"
    begin = 8 + BOUNDS[(blob[3] >> 1) & 7]
    order, kind = struct.unpack_from("<BI", blob, begin)
    assert order == 1
    if kind == 1:
        return np.array(struct.unpack_from("<2d", blob, begin + 5)).reshape(1, 2)
    (count,) = struct.unpack_from("<I", blob, begin + 5)
    assert kind == 2
    return np.frombuffer(blob, "<f8", 2 * count, begin + 9).reshape(-1, 2)


def test_a_line_string_per_line_and_file_before_and_after(tmp_path: Path):
    survey = corrected_survey.corrected()
    file, after = written(tmp_path, survey), corrected_survey.after(survey.track)
    for layer, places in (("before", survey.track[["x_m", "y_m"]].to_numpy()), ("after", after[:, :2])):
        rows = rows_of(file, f"select geom, file, begin_utc, end_utc, pings, rms_moved_m from {layer}")
        assert [row[1] for row in rows] == ["first.all", "first.all", "second.all"]
        for number, row in enumerate(rows):
            pings = slice(151 * number, 151 * (number + 1))
            np.testing.assert_allclose(vertices(row[0]), places[pings] + survey.origin, atol=1e-9)
            assert row[4] == 151
            moved = survey.track[["moved_x_m", "moved_y_m"]].to_numpy()[pings]
            assert row[5] == pytest.approx(np.sqrt((moved**2).sum(axis=1).mean()))
        assert rows[0][2] == "2017-07-14T02:40:00.250Z"
        assert rows[0][3] == "2017-07-14T02:42:30.250Z"


def test_layers_state_their_coordinate_system(tmp_path: Path):
    file = written(tmp_path, corrected_survey.corrected())
    contents = rows_of(file, "select table_name, data_type, srs_id from gpkg_contents order by table_name")
    assert contents == [(name, "features", 32633) for name in ("after", "before", "closures")]
    (system,) = rows_of(
        file, "select organization, organization_coordsys_id from gpkg_spatial_ref_sys where srs_id = 32633"
    )
    assert system == ("EPSG", 32633)
    geometries = rows_of(file, "select table_name, geometry_type_name from gpkg_geometry_columns order by table_name")
    assert dict(geometries) == {"after": "LINESTRING", "before": "LINESTRING", "closures": "POINT"}
    assert rows_of(file, "pragma integrity_check") == [("ok",)]


def test_a_local_map_is_undefined_and_cartesian(tmp_path: Path):
    file = written(tmp_path, corrected_survey.corrected("local"))
    assert {row[0] for row in rows_of(file, "select srs_id from gpkg_contents")} == {-1}


def test_closures_are_points_where_their_overlap_is(tmp_path: Path):
    survey = corrected_survey.corrected()
    file, closures = written(tmp_path, survey), survey.closures
    rows = rows_of(file, "select geom, source, target, state, shift_x_m, sigma_x_m, sigmas_after from closures")
    places = np.concatenate([vertices(row[0]) for row in rows])
    np.testing.assert_allclose(places, closures[["x_m", "y_m"]].to_numpy(float) + survey.origin, atol=1e-9)
    assert [row[1:4] for row in rows] == list(
        closures[["source", "target", "state"]].itertuples(index=False, name=None)
    )
    assert rows[0][5] == pytest.approx(0.2)
    assert rows[4][4:] == (None, None, None)  # unmatched


def test_pyogrio_reads_the_three_layers(tmp_path: Path):
    file = written(tmp_path, corrected_survey.corrected())
    assert {name for name, _ in pyogrio.list_layers(file)} == {"before", "after", "closures"}
    facts = pyogrio.read_info(file, layer="after")
    assert facts["crs"] == "EPSG:32633"
    assert facts["features"] == 3


def test_a_line_has_one_vertex_a_second_at_most_and_its_last_ping(tmp_path: Path):
    survey = corrected_survey.corrected("local")
    track = survey.track
    dense = corrected_survey.with_track(survey, time_s=1.5e9 + 0.1 * np.arange(len(track)), file="a.all")
    ((blob, pings),) = rows_of(written(tmp_path, dense), "select geom, pings from before")
    kept = track[["x_m", "y_m"]].to_numpy()[[*range(0, 453, 10), 452]]
    np.testing.assert_array_equal(vertices(blob), kept)
    assert pings == 453


def test_a_ping_alone_is_no_line(tmp_path: Path):
    survey = corrected_survey.corrected("local")
    names = np.array(["a.all"] * 200 + ["lonely.all"] + ["b.all"] * 252)
    file = written(tmp_path, corrected_survey.with_track(survey, file=names))
    assert "lonely.all" not in {row[0] for row in rows_of(file, "select file from after")}
    assert sum(row[0] for row in rows_of(file, "select pings from after")) == 452


def test_submaps_without_times_are_joined_along_their_lines(tmp_path: Path):
    survey = corrected_survey.of_submaps()
    rows = rows_of(written(tmp_path, survey), "select geom, file, begin_utc, pings from after")
    assert [row[1:] for row in rows] == [(None, None, 3)] * 3
    assert survey.submaps is not None
    np.testing.assert_allclose(vertices(rows[0][0]), survey.submaps.after[:3, :2, 3])


def test_the_same_survey_gives_the_same_bytes(tmp_path: Path):
    first = written(tmp_path, corrected_survey.corrected()).read_bytes()
    assert written(tmp_path, corrected_survey.corrected()).read_bytes() == first
    assert pyogrio.get_gdal_config_option("OGR_CURRENT_DATE") is None


def test_a_survey_without_closures_has_an_empty_layer_of_them(tmp_path: Path):
    file = written(tmp_path, corrected_survey.without_closures())
    assert rows_of(file, "select count(*) from closures") == [(0,)]
