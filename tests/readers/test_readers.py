"""Raw surveys: soundings are where the sonar saw them, and an error is one sentence."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pyproj import Geod, Transformer

from damage import corrupted
from generic_files import geographic, parquet, rows
from pointnetkl.readers.formats.recording import IMPOSSIBLE
from pointnetkl.surveys.survey import PINGS, SOUNDINGS, track_length
from pointnetkl.workflow.errors import PointNetKLError
from whole_survey import SETTINGS, Whole
from whole_survey import read as read_whole


def read(path: Path, table: pd.DataFrame, **options: Any) -> Whole:
    """Write generic pings and read them back."""
    return read_whole(parquet(path / "raw.parquet", table, **options))


def refusal(path: Path, zone: str = "auto") -> str:
    """Return the sentence with which a path is refused."""
    with pytest.raises(PointNetKLError) as caught:
        read_whole(path, replace(SETTINGS, utm_zone=zone))
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert len(sentence) < 500
    return sentence


def on_map(survey: Whole) -> np.ndarray:
    """Return soundings (n, 2) in the survey's CRS."""
    return survey.soundings[["x_m", "y_m"]].to_numpy() + survey.origin


def test_starboard_of_a_vehicle_heading_east_is_south(tmp_path: Path):
    survey = read(tmp_path, rows(pings=1, beams=3, heading=np.pi / 2, along_m=0.0))
    port, nadir, starboard = survey.soundings[["x_m", "y_m"]].to_numpy()
    np.testing.assert_allclose(port, [0, 10], atol=1e-9)
    np.testing.assert_allclose(nadir, [0, 0], atol=1e-9)
    np.testing.assert_allclose(starboard, [0, -10], atol=1e-9)
    assert survey.pings["yaw_rad"][0] == pytest.approx(0.0, abs=1e-12)


def test_a_survey_has_the_tables_of_its_contract(tmp_path: Path):
    survey = read(tmp_path, rows())
    assert list(survey.pings) == PINGS.names
    assert list(survey.soundings) == SOUNDINGS.names
    assert (survey.crs, survey.origin) == ("EPSG:32633", (5e5, 6e6))
    np.testing.assert_allclose(survey.pings["z_m"], -20)
    np.testing.assert_allclose(survey.soundings["z_m"], -50 - np.tile(np.arange(5), 4))
    assert survey.report["pings"] == 4
    assert survey.report["valid"] == survey.report["soundings"] == 20
    assert track_length(survey.pings) == pytest.approx(30)


@pytest.mark.parametrize(("longitude", "latitude"), [(17.9, 69.0), (12.05, -75.0), (-64.6, 17.85), (15.0, 0.0)])
def test_soundings_lie_where_the_geodesic_ends_also_at_the_edge_of_a_zone(
    tmp_path: Path, longitude: float, latitude: float
):
    heading, across = 0.7, np.array([-500.0, -20.0, 20.0, 500.0] * 2)
    raw = geographic(longitude, latitude, pings=2, beams=4, heading=heading, along_m=0.0, across_m=across)
    survey = read(tmp_path, raw)
    to_earth = Transformer.from_crs(survey.crs, "EPSG:4326", always_xy=True)
    seen = np.array(to_earth.transform(*on_map(survey).T))
    azimuth = np.rad2deg(heading) + np.where(across > 0, 90, -90)
    start = np.full(8, longitude), np.full(8, latitude)
    geod = Geod(ellps="WGS84")
    expected = geod.fwd(*start, azimuth, np.abs(across))[:2]
    assert np.max(geod.inv(*seen, *expected)[2]) < 0.01


def test_a_survey_that_crosses_into_another_utm_zone_stays_in_its_first(tmp_path: Path):
    raw = geographic(0.0, 55.0, pings=200)
    raw["longitude_deg"] = 5.99 + 1e-4 * np.repeat(np.arange(200), 5)
    survey = read(tmp_path, raw)
    assert survey.crs == "EPSG:32631"
    assert np.diff(survey.pings["x_m"]).max() < 7


def test_a_zone_that_is_given_is_taken(tmp_path: Path):
    path = parquet(tmp_path / "raw.parquet", geographic(5.99, 55.0))
    assert read_whole(path, replace(SETTINGS, utm_zone="EPSG:32632")).crs == "EPSG:32632"
    assert "EPSG:4326" in refusal(path, "EPSG:4326")
    assert "not a map in metres" in refusal(path, "EPSG:2263")  # New York in feet


def test_parquet_and_csv_give_the_same_survey(tmp_path: Path):
    raw = geographic(12.3456789, 60.5)
    raw.to_csv(tmp_path / "RAW.CSV", index=False)
    survey, other = read(tmp_path, raw), read_whole(tmp_path / "RAW.CSV")
    pd.testing.assert_frame_equal(survey.soundings, other.soundings)
    pd.testing.assert_frame_equal(survey.pings.drop(columns="file"), other.pings.drop(columns="file"))


def test_the_crs_may_stand_in_a_column_or_beside_the_file(tmp_path: Path):
    rows().assign(crs="EPSG:3067").to_csv(tmp_path / "column.csv", index=False)
    assert read_whole(tmp_path / "column.csv").crs == "EPSG:3067"
    rows().to_csv(tmp_path / "beside.csv", index=False)
    assert read_whole(tmp_path / "beside.csv").crs == "local"
    (tmp_path / "beside.crs").write_text("EPSG:3067\n")
    assert read_whole(tmp_path / "beside.csv").crs == "EPSG:3067"


def test_files_of_a_folder_make_one_survey_in_the_order_of_time(tmp_path: Path):
    raw = rows()
    early = raw["time_s"] < raw["time_s"].median()
    parquet(tmp_path / "a.parquet", raw[~early])
    parquet(tmp_path / "b.PARQUET", raw[early])
    (tmp_path / ".gitignore").write_text("/raw\n")
    (tmp_path / "raw.dvc").write_text("outs: []\n")
    survey = read_whole(tmp_path)
    assert list(survey.pings["file"]) == ["b.PARQUET"] * 2 + ["a.parquet"] * 2
    assert survey.pings["time_s"].is_monotonic_increasing
    pd.testing.assert_frame_equal(survey.soundings, read(tmp_path.parent, raw).soundings)


def test_a_file_that_is_stored_twice_counts_once(tmp_path: Path):
    parquet(tmp_path / "a.parquet", rows())
    shutil.copy(tmp_path / "a.parquet", tmp_path / "b.parquet")
    survey = read_whole(tmp_path)
    assert len(survey.pings) == 4
    assert survey.report["skipped"]["pings that another file has too"] == 4
    assert survey.report["files"] == 2


def test_the_heads_of_a_sonar_that_are_logged_into_two_files_are_both_kept(tmp_path: Path):
    for name, side in (("port", -1.0), ("starboard", 1.0)):
        parquet(tmp_path / f"{name}.parquet", rows(beams=9, across_m=side * np.tile(np.arange(2.0, 20.0, 2.0), 4)))
    shutil.copy(tmp_path / "port.parquet", tmp_path / "again.parquet")
    survey = read_whole(tmp_path)
    assert sorted(survey.pings["file"]) == ["again.parquet"] * 4 + ["starboard.parquet"] * 4
    assert survey.report["skipped"] == {"pings that another file has too": 4, "soundings of skipped pings": 36}


def test_a_line_that_lies_there_as_recorded_and_as_processed_counts_once(tmp_path: Path):
    raw = rows(beams=9)
    parquet(tmp_path / "a.parquet", raw)
    better = raw.assign(down_m=raw["down_m"] + 0.4, across_m=1.001 * raw["across_m"], x_m=raw["x_m"] + 0.3)
    parquet(tmp_path / "b.parquet", better)
    assert read_whole(tmp_path).report["skipped"]["pings that another file has too"] == 4


def test_two_vehicles_that_ping_at_one_time_are_both_kept(tmp_path: Path):
    parquet(tmp_path / "a.parquet", rows())
    parquet(tmp_path / "b.parquet", rows().assign(y_m=6e6 + 60.0, down_m=30.5))
    survey = read_whole(tmp_path)
    assert len(survey.pings) == 8
    assert survey.report["skipped"] == {}


def test_rows_in_any_order_give_the_same_survey(tmp_path: Path):
    raw = rows(pings=30)
    mixed = read(tmp_path, raw.sample(frac=1.0, random_state=np.random.RandomState(3)))
    pd.testing.assert_frame_equal(mixed.soundings, read(tmp_path, raw).soundings)
    assert "back in time" in mixed.report["problems"][0]


def test_what_is_skipped_is_counted(tmp_path: Path):
    raw = rows(pings=10)
    raw.loc[7, "x_m"] = np.nan  # one row of the second ping
    raw.loc[12, "down_m"] = np.nan
    raw.loc[raw["time_s"] == raw["time_s"].iloc[25], "y_m"] += 5e4
    raw.loc[41, "quality"] = 3
    survey = read(tmp_path, pd.concat([raw, raw.tail(2)]))
    assert survey.report["skipped"] == {
        "pings far off the track": 1,
        "pings without a position on the earth": 1,
        "soundings of skipped pings": 10,
        "soundings that stand twice": 2,
        "soundings without a place": 1,
    }
    assert len(survey.pings) == 8
    assert len(survey.soundings) == 39
    assert list(survey.soundings["quality"].value_counts()) == [38, 1]
    assert np.isfinite(survey.soundings.to_numpy(float)).all()


def test_roll_pitch_beam_and_quality_may_be_missing(tmp_path: Path):
    survey = read(tmp_path, rows().drop(columns=["roll_rad", "pitch_rad", "beam", "quality"]))
    assert list(survey.soundings["beam"]) == [0, 1, 2, 3, 4] * 4
    assert survey.pings["roll_rad"].isna().all()
    assert survey.report["valid"] == 20


def test_depths_beyond_any_sea_are_flagged_and_stay(tmp_path: Path):
    raw = rows()
    raw.loc[3, "down_m"] = 5e6
    survey = read(tmp_path, raw)
    assert survey.soundings["quality"][3] == 2
    assert survey.report["valid"] == 19


Change = Callable[[pd.DataFrame], pd.DataFrame]


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda t: t.drop(columns="across_m"), "column across_m is missing"),
        (lambda t: t.drop(columns="x_m"), "column longitude_deg (or x_m and y_m) is missing"),
        (lambda t: t.assign(down_m="deep"), "column down_m holds"),
        (lambda t: t.assign(time_s=pd.Timestamp(0)), "column time_s holds timestamp"),
        (lambda t: t.assign(depth_m=-20.0), "depth_m is -20 m in the middle, must be positive"),
        (lambda t: t.assign(down_m=-30.0), "down_m is -30 m in the middle, must be positive"),
        (lambda t: t.assign(heading_rad=270.0), "heading_rad reaches 270, must be radians"),
        (lambda t: t.assign(x_m=np.nan), "4 pings without a position"),
        (lambda t: t.assign(x_m=t["x_m"] + np.arange(len(t))), "x_m differs by 4 within the ping"),
        (lambda t: t.head(0), "holds no usable ping"),
    ],
)
def test_a_table_that_is_not_one_of_pings_is_refused_in_a_sentence(tmp_path: Path, change: Change, cause: str):
    sentence = refusal(parquet(tmp_path / "raw.parquet", change(rows())))
    assert cause in sentence
    assert "raw.parquet" in sentence


def test_heights_of_lakes_and_of_ground_far_above_the_sea_are_good_where_no_sonar_says_how_deep_it_was(tmp_path: Path):
    points = "x,y,elevation\n500000,6000000,{0}\n500001,6000001,{0}\n500002,6000000,9500\n"
    (tmp_path / "a.xyz").write_text(points.format(3812.5))
    survey = read_whole(tmp_path / "a.xyz")
    assert survey.soundings["quality"].to_list() == [0, 0, IMPOSSIBLE]
    assert survey.report["depth_m"] == pytest.approx([-3812.5] * 4, abs=0.01)
    pose = "VIEWPOINT 0 0 150 0.6 0 0 0.8\n"
    fields = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\n"
    (tmp_path / "a.pcd").write_text(f"{fields}{pose}POINTS 2\nDATA ascii\n10 0 -2\n0 3 -2\n")
    assert read_whole(tmp_path / "a.pcd").report["depth_m"] == pytest.approx([-148] * 4, abs=0.01)
    pings = rows().assign(down_m=-150.0, depth_m=0.0)
    pings.loc[:14, "down_m"] = 50.0
    (tmp_path / "pings").mkdir()
    assert read(tmp_path / "pings", pings).soundings["quality"].to_list() == [0] * 15 + [IMPOSSIBLE] * 5


def test_latitudes_that_are_metres_are_refused(tmp_path: Path):
    assert "latitude_deg is 6e+06" in refusal(parquet(tmp_path / "raw.parquet", geographic(15.0, 6e6)))


def test_text_in_a_column_of_numbers_is_refused_with_its_row(tmp_path: Path):
    raw = rows().astype({"down_m": object})
    raw.loc[7, "down_m"] = "soft"
    raw.to_csv(tmp_path / "raw.csv", index=False)
    sentence = refusal(tmp_path / "raw.csv")
    assert "raw.csv" in sentence
    assert "soft" in sentence
    assert "Row #9" in sentence


def test_a_damaged_parquet_file_is_refused(tmp_path: Path):
    path = parquet(tmp_path / "raw.parquet", rows(pings=300))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert "raw.parquet: is a damaged Parquet file" in refusal(path)


def test_what_is_not_there_or_unknown_is_refused(tmp_path: Path):
    assert "nowhere: is missing" in refusal(tmp_path / "nowhere")
    assert "has no raw files" in refusal(tmp_path)
    (tmp_path / "empty.gsf").touch()
    assert "empty.gsf: is empty" in refusal(tmp_path)
    (tmp_path / "empty.gsf").write_bytes(b"this is not GSF at all")
    assert "byte 8 must say GSF" in refusal(tmp_path)
    (tmp_path / "empty.gsf").rename(tmp_path / "notes.md")
    assert "notes.md: is of no known format" in refusal(tmp_path / "notes.md")
    assert "has no raw files, and 1 file of no known format, notes.md; put some there" in refusal(tmp_path)


def test_other_files_beside_raw_ones_are_ignored_and_reported(tmp_path: Path):
    alone = read(tmp_path, rows())
    (tmp_path / "README.txt").write_text("about these lines\n")
    (tmp_path / "prices.csv").write_text("item,price\ncoffee,3\n")
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0\0\x10JFIF")
    (tmp_path / "line.log").touch()
    (tmp_path / "map.tif").write_bytes(b"II*\0")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/report.pdf").write_bytes(b"%PDF-1.4\n")
    survey = read_whole(tmp_path)
    pd.testing.assert_frame_equal(survey.soundings, alone.soundings)
    assert survey.report["problems"] == [
        "passed over: 6 files of no known format, README.txt, line.log, map.tif, and 3 more"
    ]
    (tmp_path / "cut.GSF").write_bytes(b"cut off")
    assert "cut.GSF" in refusal(tmp_path)


def test_files_in_different_coordinates_are_refused(tmp_path: Path):
    parquet(tmp_path / "a.parquet", rows())
    parquet(tmp_path / "b.parquet", rows(), crs="EPSG:32634")
    assert "EPSG:32634" in refusal(tmp_path)


def test_files_from_two_seas_are_not_one_survey(tmp_path: Path):
    parquet(tmp_path / "a.parquet", geographic(15.0, 55.0))
    parquet(tmp_path / "b.parquet", geographic(-60.0, 15.0).assign(time_s=rows()["time_s"] + 1e6))
    assert "km apart" in refusal(tmp_path)


def test_mutated_tables_end_in_a_sentence_or_in_finite_soundings(tmp_path: Path):
    rng = np.random.default_rng(5)
    parquet(tmp_path / "a.parquet", rows(pings=50))
    rows(pings=50).to_csv(tmp_path / "a.csv", index=False)
    for name in ("a.parquet", "a.csv"):
        content = (tmp_path / name).read_bytes()
        for _ in range(60):
            outcome_of(tmp_path / f"mutated{name[1:]}", corrupted(content, rng))


def outcome_of(path: Path, content: bytes) -> str:
    """Read a damaged file: what comes out is a sentence, or a survey of finite numbers."""
    path.write_bytes(content)
    try:
        survey = read_whole(path)
    except PointNetKLError as error:
        return str(error)
    assert np.isfinite(survey.soundings.to_numpy(float)).all()
    assert np.isfinite(survey.pings[["time_s", "x_m", "y_m", "z_m", "yaw_rad"]].to_numpy(float)).all()
    assert len(survey.pings) + sum(n for why, n in survey.report["skipped"].items() if "pings" in why.split()[:2]) >= 1
    return ""


@pytest.mark.parametrize("wild", [slice(20, 40), slice(0, 3), slice(57, 60)])
def test_a_run_of_wild_positions_is_off_the_track(tmp_path: Path, wild: slice):
    raw = geographic(5.0, 50.0, pings=60)
    raw["longitude_deg"] = 5.0 + 1e-4 * np.repeat(np.arange(60), 5)
    clean = read(tmp_path, raw)
    lost = np.isin(np.repeat(np.arange(60), 5), np.arange(60)[wild])
    raw.loc[lost, ["longitude_deg", "latitude_deg"]] = 0.0
    survey = read(tmp_path, raw)
    assert survey.report["skipped"]["pings far off the track"] == lost.sum() / 5
    assert track_length(survey.pings) == pytest.approx(track_length(clean.pings), rel=0.06)


def test_pings_without_a_time_are_no_points_and_milliseconds_no_seconds(tmp_path: Path):
    rows().drop(columns="time_s").to_csv(tmp_path / "raw.csv", index=False)
    assert "column time_s is missing" in refusal(tmp_path / "raw.csv")
    rows().assign(time_s=1.6e12).to_csv(tmp_path / "raw.csv", index=False)
    assert "time_s reaches 1.6e+12, must be seconds since 1970" in refusal(tmp_path / "raw.csv")
