import dataclasses
import datetime
import errno
from pathlib import Path
from typing import Any

import laspy
import lazrs
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import rasterio.shutil
from pyproj import CRS

import corrected_soundings
import corrected_survey
from pointnetkl.correction import maps
from pointnetkl.correction.maps import table
from pointnetkl.correction.result import Corrected, CorrectionError
from pointnetkl.readers.formats import las
from pointnetkl.surveys.survey import SUBMAPS, SurveyError
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError

SURVEY = corrected_survey.corrected()
SOUNDINGS = corrected_soundings.swaths(SURVEY.track)
AFTER = maps.renavigated(SOUNDINGS, SURVEY.track)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Products of the survey."""
    path = tmp_path_factory.mktemp("corrected")
    corrected_soundings.write(path, SURVEY, SOUNDINGS)
    return path


@pytest.fixture(scope="module")
def cloud(folder: Path) -> laspy.LasData:
    """The cloud, read by laspy."""
    return laspy.read(folder / maps.CLOUD)


def test_laspy_finds_every_sounding_at_its_corrected_place(cloud: laspy.LasData) -> None:
    np.testing.assert_allclose(np.column_stack([cloud.x, cloud.y]), AFTER + SURVEY.origin, atol=0.00051)
    np.testing.assert_allclose(cloud.z, SOUNDINGS["z_m"], atol=0.00051)
    assert cloud.header.version == "1.4"
    assert cloud.header.point_format.id == 6
    assert cloud.header.scales.tolist() == [0.001] * 3
    assert cloud.header.offsets.tolist() == [*SURVEY.origin, 0.0]
    np.testing.assert_allclose(cloud.header.mins[:2], (AFTER + SURVEY.origin).min(axis=0), atol=0.00051)
    np.testing.assert_allclose(cloud.header.maxs[2], SOUNDINGS["z_m"].max(), atol=0.00051)


def test_the_cloud_has_flags_classes_and_the_soundings_own_numbers(cloud: laspy.LasData) -> None:
    quality = SOUNDINGS["quality"].to_numpy()
    for name in ("ping", "beam", "quality"):
        np.testing.assert_array_equal(cloud[name], SOUNDINGS[name])
    assert [cloud[name].dtype for name in ("ping", "beam", "quality")] == [np.uint32, np.int32, np.uint8]
    np.testing.assert_array_equal(cloud.withheld, quality > 0)
    np.testing.assert_array_equal(cloud.classification, np.array([40, 1, 7, 7])[quality])
    assert set(cloud.return_number) == set(cloud.number_of_returns) == {1}
    assert not np.any(cloud.synthetic)


def test_times_of_the_cloud_are_adjusted_standard_gps_time(cloud: laspy.LasData) -> None:
    # GPS time began on 6 January 1980, and was 18 s ahead of UTC in 2017
    epoch = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC).timestamp()
    utc = SURVEY.track["time_s"].to_numpy()[SOUNDINGS["ping"]]
    np.testing.assert_allclose(cloud.gps_time, utc - epoch + 18 - 1e9, atol=1e-6)
    assert cloud.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert cloud.header.creation_date == datetime.date(2017, 7, 14)


def test_leap_seconds_are_those_of_each_ping(tmp_path: Path) -> None:
    new_year = datetime.datetime(2017, 1, 1, tzinfo=datetime.UTC).timestamp()
    steps = np.arange(len(SURVEY.track)) - 100.0
    survey = corrected_survey.with_track(SURVEY, time_s=new_year + steps)
    corrected_soundings.write(tmp_path, survey, SOUNDINGS)
    step = np.diff(laspy.read(tmp_path / maps.CLOUD).gps_time[:: corrected_soundings.BEAMS])
    assert step[99] == 2.0  # the leap second
    assert set(np.delete(step, 99)) == {1.0}


def test_times_before_leap_seconds_are_known_and_of_submaps_are_left_out(tmp_path: Path) -> None:
    old = corrected_survey.with_track(SURVEY, time_s=8e8 + np.arange(len(SURVEY.track)))
    counted = corrected_survey.with_track(SURVEY, time_s=np.arange(float(len(SURVEY.track))))
    for name, survey in (("old", old), ("submaps", dataclasses.replace(counted, kind=SUBMAPS))):
        corrected_soundings.write(tmp_path / name, survey, SOUNDINGS)
        points = laspy.read(tmp_path / name / maps.CLOUD)
        assert not points.gps_time.any()
        assert points.header.creation_date is None
    assert pq.read_table(tmp_path / "submaps" / maps.TABLE)["time_s"].to_pandas().isna().all()
    np.testing.assert_array_equal(
        pq.read_table(tmp_path / "old" / maps.TABLE)["time_s"], old.track["time_s"].to_numpy()[SOUNDINGS["ping"]]
    )


def test_the_point_source_is_the_number_of_the_raw_file(cloud: laspy.LasData) -> None:
    names = np.array(["", *corrected_survey.FILES])[cloud.point_source_id]
    np.testing.assert_array_equal(names, SURVEY.track["file"].to_numpy()[SOUNDINGS["ping"]])


def test_the_cloud_states_its_crs(cloud: laspy.LasData) -> None:
    assert CRS.from_user_input(cloud.header.parse_crs()).to_epsg() == 32633
    assert cloud.header.global_encoding.wkt


def test_lazrs_unpacks_the_points_by_itself(folder: Path, cloud: laspy.LasData) -> None:
    with laspy.open(folder / maps.CLOUD) as file:
        record = next(vlr for vlr in file.header.vlrs if vlr.record_id == 22204)
    raw = np.zeros(len(SOUNDINGS) * cloud.header.point_format.size, np.uint8)
    with (folder / maps.CLOUD).open("rb") as file:
        file.seek(cloud.header.offset_to_point_data)
        lazrs.LasZipDecompressor(file, record.record_data).decompress_many(raw)
    assert raw.tobytes() == cloud.points.array.tobytes()


def test_our_own_reader_reads_the_cloud(folder: Path) -> None:
    parts = list(las.read(folder / maps.CLOUD))
    soundings = pd.concat([part.soundings for part in parts])
    assert parts[0].crs == "EPSG:32633"
    assert not parts[-1].problems
    np.testing.assert_allclose(soundings[["east", "north"]], AFTER + SURVEY.origin, atol=0.00051)
    np.testing.assert_array_equal(soundings["quality"] > 0, SOUNDINGS["quality"] > 0)


def test_our_own_reader_reads_a_cloud_whose_place_on_the_earth_is_not_known(tmp_path: Path) -> None:
    survey = corrected_survey.corrected("local")
    corrected_soundings.write(tmp_path, survey, SOUNDINGS)
    part = next(las.read(tmp_path / maps.CLOUD))
    assert part.crs == "local"
    np.testing.assert_allclose(part.soundings[["east", "north"]], AFTER, atol=0.00051)


def test_points_without_pings_have_no_ping_in_the_cloud(tmp_path: Path) -> None:
    survey = corrected_soundings.without_pings(SURVEY)
    corrected_soundings.write(tmp_path, survey, SOUNDINGS.assign(ping=-1, beam=0))
    points = laspy.read(tmp_path / maps.CLOUD)
    assert list(points.point_format.extra_dimension_names) == ["quality"]
    np.testing.assert_allclose(points.x, SOUNDINGS["x_m"] + SURVEY.origin[0], atol=0.00051)
    assert not points.point_source_id.any()


def test_a_survey_too_wide_for_millimetres_has_centimetres(tmp_path: Path) -> None:
    far = SOUNDINGS.copy()
    far.loc[40, "x_m"] = -3e6  # a rejected one
    corrected_soundings.write(tmp_path, SURVEY, far)
    points = laspy.read(tmp_path / maps.CLOUD)
    assert points.header.scales.tolist() == [0.01, 0.01, 0.001]
    after = maps.renavigated(far, SURVEY.track) + SURVEY.origin
    np.testing.assert_allclose(points.x, after[:, 0], atol=0.0051)


@pytest.mark.parametrize("x", [1e9, np.nan])
def test_a_sounding_without_a_place_on_the_earth_is_refused(tmp_path: Path, x: float) -> None:
    wild = SOUNDINGS.copy()
    wild.loc[40, "x_m"] = x
    with pytest.raises(CorrectionError, match="beyond the earth"):
        corrected_soundings.write(tmp_path, SURVEY, wild)
    assert not list(tmp_path.iterdir())


def test_the_table_has_every_sounding_at_its_corrected_place(folder: Path) -> None:
    read = pq.read_table(folder / maps.TABLE)
    assert read.schema.remove_metadata() == table.SOUNDINGS
    rows = read.to_pandas()
    np.testing.assert_array_equal(rows[["x_m", "y_m"]], AFTER + SURVEY.origin)
    np.testing.assert_array_equal(rows["time_s"], SURVEY.track["time_s"].to_numpy()[SOUNDINGS["ping"]])
    same = ["ping", "beam", "z_m", "quality"]
    pd.testing.assert_frame_equal(rows[same], SOUNDINGS[same])
    metadata = artifacts.table_metadata(folder / maps.TABLE)
    assert (metadata["crs"], metadata["vertical"]) == ("EPSG:32633", ["water line"])


def test_a_track_left_as_it_was_leaves_soundings_where_they_were(tmp_path: Path) -> None:
    corrected_soundings.write(tmp_path, corrected_survey.corrected(applied=False), SOUNDINGS)
    rows = pq.read_table(tmp_path / maps.TABLE).to_pandas()
    np.testing.assert_array_equal(rows[["x_m", "y_m"]], SOUNDINGS[["x_m", "y_m"]].to_numpy() + SURVEY.origin)


def test_without_a_good_sounding_there_is_nothing_to_map(tmp_path: Path) -> None:
    with pytest.raises(CorrectionError, match="none of 18573 soundings is good"):
        corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS.assign(quality=np.int8(1)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("owner", "name"),
    [(laspy.LasWriter, "write_points"), (pq.ParquetWriter, "write_table"), (rasterio.shutil, "copy")],
)
def test_a_disk_that_fills_ends_in_one_sentence_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(owner, name, full)
    with pytest.raises(PointNetKLError) as caught:
        corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    assert "No space left on device" in str(caught.value)
    assert "partial" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_disk_full_for_the_compressed_cloud_ends_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Path.open

    def small(self: Path, *args: Any, **kwargs: Any) -> Any:
        return _Small(opened(self, *args, **kwargs)) if self.name == maps.CLOUD else opened(self, *args, **kwargs)

    monkeypatch.setattr(Path, "open", small)
    with pytest.raises(CorrectionError, match=r"soundings\.laz: cannot be written"):
        corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    assert not list(tmp_path.iterdir())


def test_products_of_an_earlier_run_stay_where_a_later_one_fails(tmp_path: Path) -> None:
    corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(SurveyError, match="a fault"):
        maps.write(tmp_path, SURVEY, _broken(SURVEY), 2.0)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def _broken(survey: Corrected) -> Any:
    def parts() -> Any:
        parts.calls += 1  # type: ignore[attr-defined]
        yield SOUNDINGS[:1000]
        if parts.calls == 2:  # type: ignore[attr-defined]
            raise SurveyError("a fault")

    parts.calls = 0  # type: ignore[attr-defined]
    return parts


class _Small:
    """A file on a disk that has room for 4096 bytes."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def __enter__(self) -> "_Small":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, content: bytes) -> int:
        if self._file.tell() + len(content) > 4096:
            raise OSError(errno.ENOSPC, "No space left on device")
        return int(self._file.write(content))
