"""GSF: the sonar's own numbers, port and starboard not confused; damage costs only the damaged records."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pyproj import Geod, Transformer

import gsf_files as made
import whole_survey
from damage import corrupted
from pointnetkl.readers.formats import gsf
from pointnetkl.readers.formats.recording import IMPOSSIBLE, REJECTED, Recording
from pointnetkl.surveys.survey import SurveyError, track_length
from realdata import REALDATA
from whole_survey import Whole

GSF = REALDATA / "gsf"
REAL = ["em302_st_croix.gsf", "em302_deep.gsf", "stub_3_09.gsf"]
real = pytest.mark.skipif(not GSF.exists(), reason="no real data here")
OLD = made.header("GSF-v02.09")


def written(path: Path, *records: bytes, head: bytes | None = None) -> Path:
    path.write_bytes((made.header() if head is None else head) + b"".join(records))
    return path


def pings(count: int = 12, **fields: Any) -> list[bytes]:
    return [made.swath(number, **fields) for number in range(count)]


def only(path: Path) -> Recording:
    (recording,) = gsf.read(path)
    return recording


def places_of(records: list[bytes]) -> list[int]:
    """Return the byte at which each record begins, behind the header."""
    return list(np.cumsum([len(made.header()), *(len(record) for record in records)]))[:-1]


def test_a_written_ping_is_read_where_it_was(tmp_path: Path):
    survey = whole_survey.read(written(tmp_path / "small.gsf", *pings()))
    assert survey.crs == "EPSG:32631"
    assert survey.report["valid"] == 12 * 20
    ping = survey.soundings[survey.soundings["ping"] == 0]
    offset = ping[["x_m", "y_m"]].to_numpy() - survey.pings[["x_m", "y_m"]].to_numpy()[0]
    # the grid's north is 0.35 degrees off there, which turns 40 m by 0.24 m
    np.testing.assert_allclose(offset, np.stack([np.full(21, 2.0), -made.BEAMS], 1), atol=0.3)
    np.testing.assert_allclose(ping["z_m"], made.BEAMS / 8 - 45, atol=0.01)
    np.testing.assert_allclose(survey.pings[["roll_rad", "pitch_rad"]][:1], np.deg2rad([[1, -1]]))
    assert survey.pings["time_s"][5] == made.TIME + 5


@pytest.mark.parametrize(("version", "major"), [("01.09", 1), ("02.00", 2), ("02.09", 2), ("03.01", 3), ("03.10", 3)])
def test_the_header_of_a_ping_is_that_of_the_file_s_version(tmp_path: Path, version: str, major: int):
    path = written(tmp_path / "old.gsf", *pings(major=major), head=made.header(f"GSF-v{version}"))
    recording = only(path)
    assert not recording.skipped
    np.testing.assert_allclose(recording.soundings["down_m"][:21], made.DEPTH, atol=0.005)
    np.testing.assert_allclose(recording.soundings["across_m"][:21], made.ACROSS)


@pytest.mark.parametrize(("width", "factors"), [(1, (3, -20)), (2, (100, -30)), (2, (50, 7)), (4, (100_000, 1000))])
def test_arrays_of_any_width_scale_and_offset_are_the_same_soundings(
    tmp_path: Path, width: int, factors: tuple[int, int]
):
    scales = made.SCALES | {1: factors, 2: (factors[0], 0), 3: (factors[0], 0)}
    parts = [made.scale_factors(scales), *made.soundings(scales, width)]
    soundings = only(written(tmp_path / "small.gsf", *pings(parts=parts))).soundings
    rounding = 0.5001 / factors[0]
    for name, values in (("down_m", made.DEPTH), ("across_m", made.ACROSS), ("along_m", made.ALONG)):
        np.testing.assert_allclose(soundings[name], np.tile(values, 12), atol=rounding)


def test_scale_factors_hold_until_others_come(tmp_path: Path):
    finer = made.SCALES | {1: (1000, -30)}
    records = [made.swath(0), made.swath(1, made.soundings())]
    records += [made.swath(2, [made.scale_factors(finer), *made.soundings(finer)])]
    records += [made.swath(3, made.soundings(finer)), made.swath(4)]
    soundings = only(written(tmp_path / "small.gsf", *records)).soundings
    np.testing.assert_allclose(soundings["down_m"], np.tile(made.DEPTH, 5), atol=0.005)


def test_depth_holds_the_vehicle_s_depth_already(tmp_path: Path):
    ship = only(written(tmp_path / "ship.gsf", *pings(corrector=-3.0)))
    vehicle = only(written(tmp_path / "vehicle.gsf", *pings(corrector=30.0)))
    unknown = only(written(tmp_path / "unknown.gsf", *pings(corrector=99.99)))
    assert ship.pings["depth_m"].eq(0).all()
    assert unknown.pings["depth_m"].eq(0).all()
    assert vehicle.pings["depth_m"].eq(30).all()
    np.testing.assert_allclose(ship.soundings["down_m"], vehicle.soundings["down_m"] + 30)


def test_a_rejected_ping_rejects_its_soundings_and_one_without_position_is_skipped(tmp_path: Path):
    assert only(written(tmp_path / "a.gsf", *pings(flags=1))).soundings["quality"].eq(REJECTED).all()
    assert only(written(tmp_path / "a.gsf", *pings(flags=2))).soundings["quality"].eq(REJECTED).sum() == 12
    with pytest.raises(SurveyError, match="12 pings without a position"):
        whole_survey.read(written(tmp_path / "b.gsf", *pings(longitude=181.0, latitude=91.0)))
    with pytest.raises(SurveyError, match="12 pings without a heading"):
        whole_survey.read(written(tmp_path / "c.gsf", *pings(heading=361.0)))


def test_a_beam_is_refused_by_the_lowest_bit_of_its_flags_and_not_for_being_selected(tmp_path: Path):
    flags = bytes([0, 1, 2, 5, 6, 0x10, 0x21, 0x82, *range(0, 26, 2)])
    ping = made.swath(0, [made.scale_factors(made.SCALES), *made.soundings(), made.part(16, flags)])
    quality = only(written(tmp_path / "small.gsf", ping)).soundings["quality"]
    assert list(np.flatnonzero(quality)) == [1, 3, 6]


def test_the_sonar_s_two_tests_count_only_where_beams_have_no_flags(tmp_path: Path):
    tests = made.part(15, bytes([0b00_01_10_11, 0b11_11_11_00]) + b"\xff" * 4)
    arrays = [made.scale_factors(made.SCALES), *made.soundings(), tests]
    quality = only(written(tmp_path / "a.gsf", made.swath(0, arrays))).soundings["quality"]
    assert list(np.flatnonzero(quality)) == [0, 7]
    flagged = made.swath(0, [*arrays, made.part(16, bytes(21))])
    assert only(written(tmp_path / "b.gsf", flagged)).soundings["quality"].eq(0).all()


def test_nominal_depths_stand_in_where_a_ping_has_no_others(tmp_path: Path):
    nominal = made.array(14, made.DEPTH)
    scales, depth, across, along = made.scale_factors(made.SCALES), *made.soundings()
    alone = only(written(tmp_path / "a.gsf", made.swath(0, [scales, nominal, across, along])))
    np.testing.assert_allclose(alone.soundings["down_m"], made.DEPTH, atol=0.005)
    deeper = made.array(14, made.DEPTH + 5)
    both = only(written(tmp_path / "b.gsf", made.swath(0, [scales, depth, across, along, deeper])))
    np.testing.assert_allclose(both.soundings["down_m"], made.DEPTH, atol=0.005)


def test_a_beam_without_a_depth_or_place_is_impossible_but_a_single_one_looks_straight_down(tmp_path: Path):
    depth = np.where(np.arange(21) == 4, 0, made.DEPTH)
    parts = [made.scale_factors(made.SCALES), made.array(1, depth), made.array(2, made.ACROSS)]
    quality = only(written(tmp_path / "a.gsf", made.swath(0, parts))).soundings["quality"]
    assert list(np.flatnonzero(quality == IMPOSSIBLE)) == [4]
    assert (
        only(written(tmp_path / "b.gsf", made.swath(0, parts[:2]))).soundings["quality"].ne(0).sum() == 21
    )  # no place across track
    single_beam = made.swath(0, [parts[0], made.array(1, np.array([45.0])), made.part(212, bytes(8))], beams=1)
    recording = only(written(tmp_path / "c.gsf", single_beam))
    assert list(recording.soundings["quality"]) == [0]
    assert recording.sensor == "Navisound"


def test_records_of_single_beams_are_pings_of_one_beam(tmp_path: Path):
    records = [made.single_beam(number, depth=45.5, corrector=4.0) for number in range(5)]
    recording = only(written(tmp_path / "single.gsf", *records, made.single_beam(5, depth=0)))
    assert list(recording.pings["time_s"] - made.TIME) == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(recording.pings[["roll_rad", "pitch_rad"]][:1], np.deg2rad([[1, -1]]))
    assert list(recording.soundings["quality"]) == [0, 0, 0, 0, 0, IMPOSSIBLE]
    assert list(recording.soundings["down_m"][:5]) == [41.5] * 5
    assert recording.sensor == "Odom Echotrac"


def test_records_of_other_types_and_of_private_registries_are_passed_over(tmp_path: Path):
    attitude = [made.attitude(number) for number in range(3000)]
    private = made.record(7, bytes(100), registry=3)
    records = [made.record(made.COMMENT, bytes(40)), made.swath(0), *attitude, private, made.swath(1)]
    recording = only(written(tmp_path / "small.gsf", *records, *attitude[:2], made.swath(2)))
    assert list(recording.pings["time_s"] - made.TIME) == [0, 1, 2]
    assert (recording.skipped, recording.problems) == ({}, [])


@pytest.mark.parametrize(
    ("kind", "content", "name"),
    [
        (134, bytes([1, 46, 0, 9, 0, 101]), "Kongsberg EM302, serial 101"),
        (149, bytes([7, 253, 0, 9, 0, 101]), "Kongsberg EM2040, model 2045, serial 101"),
        (156, bytes([1, 0, 0, 0, 0x01, 0x30]), "Kongsberg EM304"),
        (152, b"2024".ljust(12, b"\0") + b"101".ljust(12, b"\0"), "R2Sonic 2024, serial 101"),
        (122, bytes(8), "Reson SeaBat 8101"),
        (163, bytes(8), "sensor id 163"),
    ],
)
def test_the_sensor_is_named_by_the_part_that_is_its_own(tmp_path: Path, kind: int, content: bytes, name: str):
    parts = [made.scale_factors(made.SCALES), *made.soundings(), made.part(kind, content.ljust(40, b"\0"))]
    assert only(written(tmp_path / "small.gsf", made.swath(0, parts))).sensor == name


def test_what_depths_are_below_and_which_corrections_are_left_is_reported(tmp_path: Path):
    parameters = made.parameters(
        TIDAL_DATUM="MLLW", TIDE_COMPENSATED="YES", DRAFT_TO_APPLY="+01.20", ROLL_TO_APPLY="+00.00"
    )
    recording = only(written(tmp_path / "a.gsf", parameters, *pings()))
    assert recording.vertical == "below MLLW; tide applied"
    assert [problem for problem in recording.problems if "DRAFT_TO_APPLY +01.20)" in problem]
    assert only(written(tmp_path / "b.gsf", *pings())).vertical == "below the water line; tide not applied"
    assert only(written(tmp_path / "c.gsf", *pings(tide=1.5))).vertical.startswith("below a tidal datum that the file")


def test_parts_are_the_whole_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = written(tmp_path / "small.gsf", *pings(), head=made.header() + bytes(50))
    expected = only(path)
    monkeypatch.setattr(gsf, "PART", 100)
    parts = list(gsf.read(path))
    assert [len(part.pings) for part in parts] == [5, 5, 2]
    assert sum(len(part.problems) for part in parts) == 1
    assert all(set(part.soundings["ping"]) == set(range(len(part.pings))) for part in parts)
    columns = ["beam", "along_m", "across_m", "down_m", "quality"]
    joined = pd.concat([part.soundings[columns] for part in parts], ignore_index=True)
    pd.testing.assert_frame_equal(joined, expected.soundings[columns])


def test_a_file_is_recognised_by_its_content_and_not_by_its_name(tmp_path: Path):
    assert len(whole_survey.read(written(tmp_path / "line.d01", *pings())).pings) == 12


def test_what_is_not_gsf_or_has_no_pings_is_reported(tmp_path: Path):
    with pytest.raises(gsf.GsfError, match=r"byte 8 must say GSF-v01 to GSF-v03"):
        only(written(tmp_path / "a.gsf", head=made.header("GSF-v07.01")))
    with pytest.raises(gsf.GsfError, match="cannot be read"):
        only(tmp_path / "missing.gsf")
    empty = only(written(tmp_path / "b.gsf", made.attitude()))
    assert (len(empty.pings), len(empty.soundings)) == (0, 0)
    assert empty.problems == ["b.gsf: no ping is among its records"]


def test_a_file_that_was_cut_off_gives_what_is_before_and_says_where(tmp_path: Path):
    records = pings()
    cut = places_of(records)[7]
    path = written(tmp_path / "small.gsf", *records)
    path.write_bytes(path.read_bytes()[: cut + 30])
    recording = only(path)
    assert len(recording.pings) == 7
    assert recording.problems == [f"small.gsf: 30 bytes from byte {cut} on are damaged or cut off"]


def test_a_damaged_length_costs_its_record_alone(tmp_path: Path):
    records = pings()
    path, place = written(tmp_path / "small.gsf", *records), places_of(records)[5]
    content = bytearray(path.read_bytes())
    content[place] = 0x7F
    path.write_bytes(content)
    recording = only(path)
    assert list(recording.pings["time_s"] - made.TIME) == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert f"{len(records[5])} bytes from byte {place}" in recording.problems[0]


def test_a_checksum_that_does_not_match_costs_the_ping(tmp_path: Path):
    records = pings(checksum=True)
    path, place = written(tmp_path / "sums.gsf", *records), places_of(records)[5]
    content = bytearray(path.read_bytes())
    content[place - 20] ^= 0x55
    path.write_bytes(content)
    recording = only(path)
    assert len(recording.pings) == 11
    assert recording.skipped == {"unreadable pings": 1}
    assert "checksum" in recording.problems[0]


def test_depths_are_not_read_with_scale_factors_that_may_be_lost(tmp_path: Path):
    records = [
        *pings(3),
        made.swath(3, [b"\x64\xff\0\0" + bytes(40)]),
        *(made.swath(n, made.soundings()) for n in range(4, 12)),
    ]
    recording = only(written(tmp_path / "small.gsf", *records))
    assert len(recording.pings) == 3
    assert recording.skipped == {"unreadable pings": 9}
    assert "no scale factors" in recording.problems[-1]


@pytest.mark.parametrize(
    ("parts", "cause"),
    [
        ([made.part(100, b"\0\0\0\5")], "scale factors are cut off"),
        ([made.scale_factors({1: (0, 0)})], "is zero"),
        ([made.part(1, bytes(50))], "50 bytes for 21 beams"),
        ([made.scale_factors(made.SCALES), *made.soundings(), made.part(16, bytes(20))], "20 beam flags for 21"),
        ([made.scale_factors(made.SCALES)], "no depths"),
    ],
)
def test_a_ping_that_contradicts_itself_is_not_read(tmp_path: Path, parts: list[bytes], cause: str):
    recording = only(written(tmp_path / "small.gsf", made.swath(0, parts), made.swath(1)))
    assert recording.skipped == {"unreadable pings": 1}
    assert cause in recording.problems[0]
    assert len(recording.pings) == 1


def test_a_time_beyond_its_second_is_not_read(tmp_path: Path):
    assert only(written(tmp_path / "small.gsf", made.swath(0, nanoseconds=2**30))).skipped == {"unreadable pings": 1}


def test_only_the_first_places_of_damage_are_reported_and_the_others_counted(tmp_path: Path):
    torn = [piece for number in range(50) for piece in (*pings(3), b"\xff" * 40)]
    recording = only(written(tmp_path / "small.gsf", *torn))
    assert len(recording.pings) == 150
    assert (len(recording.problems), recording.problems_omitted) == (20, 30)


def test_mutated_files_end_in_a_sentence_or_in_finite_soundings(tmp_path: Path):
    rng, path = np.random.default_rng(0), tmp_path / "mutated.gsf"
    sources = [written(tmp_path / "a.gsf", made.parameters(A="1"), *pings(4), made.single_beam()).read_bytes()]
    sources += [(GSF / name).read_bytes()[:30_000] for name in REAL[1:] if GSF.exists()]
    reported = 0
    for number in range(400):
        path.write_bytes(corrupted(sources[number % len(sources)], rng))
        try:
            recording = only(path)
        except gsf.GsfError:
            reported += 1
            continue
        assert np.isfinite(recording.soundings.to_numpy(float)).all()
        assert recording.soundings["ping"].isin(recording.pings.index).all()
        reported += bool(recording.problems)
    assert 50 < reported < 400


def test_garbage_behind_a_good_beginning_does_not_hang(tmp_path: Path):
    content = written(tmp_path / "small.gsf", *pings()).read_bytes()
    noise = np.random.default_rng(1).integers(0, 256, 1 << 22, dtype=np.uint8).tobytes()
    almost = made.record(made.PING, bytes(16)) + made.record(made.PING, bytes(16))[:8]  # two in a row are no chain
    for filling in (noise, bytes(1 << 22), b"\0\0\0\2" * (1 << 20), (almost + b"\xff" * 9) * 50_000):
        (tmp_path / "small.gsf").write_bytes(content + filling + made.swath(99))
        recording = only(tmp_path / "small.gsf")
        assert list(recording.pings["time_s"] - made.TIME) == [*range(12), 99]


@real
def test_the_real_survey_has_the_counts_that_are_known():
    survey = whole_survey.read(GSF / "em302_st_croix.gsf")
    good = -survey.soundings["z_m"][survey.soundings["quality"] == 0]
    assert (len(survey.pings), len(survey.soundings), len(good)) == (50, 21_600, 20_959)
    assert survey.report["skipped"] == {}
    assert track_length(survey.pings) == pytest.approx(1247, rel=0.004)  # on the ellipsoid it is 1243
    assert np.ptp(survey.pings["time_s"]) == pytest.approx(298, abs=1)
    np.testing.assert_allclose(good.quantile([0.01, 0.99]), [1244, 2291], atol=1)
    assert only(GSF / "em302_st_croix.gsf").sensor == "Kongsberg EM302, serial 101"


@real
def test_the_deep_survey_and_the_stub_have_the_counts_that_are_known():
    deep = whole_survey.read(GSF / "em302_deep.gsf")
    assert (len(deep.pings), len(deep.soundings)) == (8, 8 * 432)
    assert -deep.soundings["z_m"].median() == pytest.approx(4060, abs=40)
    stub = whole_survey.read(GSF / "stub_3_09.gsf")
    assert (len(stub.pings), len(stub.soundings), stub.report["valid"]) == (3, 21, 0)


@real
@pytest.mark.parametrize("name", REAL)
def test_the_soundings_are_those_of_a_reader_in_python(name: str):
    library = pytest.importorskip("GSFU")
    recording, file = only(GSF / name), library.gsf(str(GSF / name))
    theirs = [ping for _, _, ping in file.iter_records(made.PING)]
    file.closeFile()
    assert_same(recording, [ping["Depth_m"] for ping in beams_of(theirs)], "down_m")
    if name != REAL[2]:
        assert_same(recording, [ping["AcrossTrack_m"] for ping in beams_of(theirs)], "across_m")
        assert_same(recording, [ping["AlongTrack_m"] for ping in beams_of(theirs)], "along_m")
    flags = np.concatenate([ping["BeamFlags"] for ping in beams_of(theirs)])
    assert np.array_equal(recording.soundings["quality"] == REJECTED, (flags & 1) != 0)
    assert list(recording.pings["north"]) == [ping["Latitude_deg"] for ping in theirs]


def beams_of(theirs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [ping["Beams"] for ping in theirs]


def assert_same(recording: Recording, theirs: list[np.ndarray], name: str) -> None:
    np.testing.assert_array_equal(recording.soundings[name], np.concatenate(theirs))


@real
@pytest.mark.parametrize("name", REAL[:2])
def test_the_soundings_are_those_of_the_format_s_own_library(name: str):
    assert_same_as_the_library(GSF / name)


@pytest.mark.parametrize(("version", "factors"), [("01.09", (100, 0)), ("02.09", (50, 7))])
@pytest.mark.parametrize("beams_have", ["flags", "tests"])
def test_old_files_are_read_as_by_the_format_s_own_library(
    tmp_path: Path, version: str, factors: tuple[int, int], beams_have: str
):
    scales = dict.fromkeys(made.SCALES, factors)
    arrays = made.soundings(scales)
    arrays += [made.part(16, bytes(range(21))) if beams_have == "flags" else made.part(15, bytes(range(0, 12, 2)))]
    head, records = made.header(f"GSF-v{version}"), [made.swath(0, [made.scale_factors(scales), *arrays], major=2)]
    records += [made.swath(number, arrays, major=2, corrector=number - 3.0) for number in range(1, 6)]
    assert_same_as_the_library(written(tmp_path / "old.gsf", *records, head=head))


def test_arrays_of_four_bytes_are_read_as_by_the_format_s_own_library(tmp_path: Path):
    scales = dict.fromkeys(made.SCALES, (100_000, -12))
    parts = [made.scale_factors(scales), *made.soundings(scales, 4), made.part(16, bytes(21))]
    assert_same_as_the_library(written(tmp_path / "new.gsf", *pings(parts=parts, checksum=True)))


def test_single_beams_are_read_as_by_the_format_s_own_library(tmp_path: Path):
    library = pytest.importorskip("gsfpy3_09")
    path = written(tmp_path / "single.gsf", made.single_beam(2, 45.5, 4.0))
    with library.open_gsf(path) as file:
        theirs = file.read(library.enums.RecordType.GSF_RECORD_SINGLE_BEAM_PING)[1].sb_ping
    recording = only(path)
    assert recording.soundings["down_m"][0] + recording.pings["depth_m"][0] == theirs.depth == 45.5
    assert recording.pings["depth_m"][0] == theirs.depth_corrector == 4.0
    angles = np.deg2rad([theirs.roll, theirs.pitch, theirs.heading])
    np.testing.assert_allclose(recording.pings.loc[0, ["roll_rad", "pitch_rad", "heading_rad"]].to_numpy(float), angles)


def assert_same_as_the_library(path: Path) -> None:
    """Compare every ping with what gsfpy, the C library, reads."""
    library = pytest.importorskip("gsfpy3_09")
    recording = only(path)
    kind = library.enums.RecordType.GSF_RECORD_SWATH_BATHYMETRY_PING
    with library.open_gsf(path) as file:
        for number, ping in recording.pings.iterrows():
            theirs = file.read(kind)[1].mb_ping
            ours = recording.soundings[recording.soundings["ping"] == number]
            count = theirs.number_beams
            np.testing.assert_allclose(ours["down_m"] + ping["depth_m"], theirs.depth[:count], rtol=1e-15)
            np.testing.assert_array_equal(ours["across_m"], theirs.across_track[:count])
            np.testing.assert_array_equal(ours["along_m"], theirs.along_track[:count])
            flags = (np.array(theirs.beam_flags[:count]) & 1) != 0 if theirs.beam_flags else None
            tests = np.array(theirs.quality_flags[:count]) == 0 if theirs.quality_flags else None
            assert np.array_equal(ours["quality"] == REJECTED, tests if flags is None else flags)
            corrected = theirs.depth_corrector != 99.99
            assert ping["depth_m"] == (max(0.0, theirs.depth_corrector) if corrected else 0.0)
            time = theirs.ping_time.tv_sec + theirs.ping_time.tv_nsec / 1e9
            # gsfpy has the names of the library's two fields the wrong way round: no latitude is 167 degrees
            assert (ping["time_s"], ping["east"], ping["north"]) == (time, theirs.latitude, theirs.longitude)
            assert np.rad2deg(ping["heading_rad"]) == pytest.approx(theirs.heading, abs=1e-9)
        with pytest.raises(library.GsfException):
            file.read(kind)


@pytest.mark.slow
def test_the_race_of_readers_ends_in_its_numbers(tmp_path: Path):
    path = written(tmp_path / "small.gsf", *pings(3), made.attitude())
    words = ["--source", str(path), "--megabytes", "0.05", "--repetitions", "1"]
    command = [sys.executable, "benchmarks/readers_gsf.py", *words]
    result = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout.splitlines()[-1])
    assert report["bytes"] >= 50_000
    assert report["ours"]["soundings"] % (3 * 21) == 0
    assert report["ratio_ours"] == 1


@real
@pytest.mark.parametrize("name", REAL[:2])
def test_soundings_lie_where_a_geodesic_from_the_ping_leads(name: str):
    survey, recording = whole_survey.read(GSF / name), only(GSF / name)
    table = recording.soundings
    ping = recording.pings.iloc[table["ping"]]
    azimuth = np.rad2deg(ping["heading_rad"].to_numpy() + np.arctan2(table["across_m"], table["along_m"]))
    away = np.hypot(table["across_m"], table["along_m"])
    east, north, _ = Geod(ellps="WGS84").fwd(ping["east"], ping["north"], azimuth, away)
    x, y = Transformer.from_crs("EPSG:4326", survey.crs, always_xy=True).transform(east, north)
    off = np.hypot(survey.soundings["x_m"] + survey.origin[0] - x, survey.soundings["y_m"] + survey.origin[1] - y)
    assert (off < 0.01 + 2e-5 * away).all()  # a map turns and stretches a little from one end of a swath to the other


def disagreement(survey: Whole, mirrored: bool) -> float:
    """Return the median difference in depth of soundings of different pings in one cell, metres."""
    soundings = survey.soundings[survey.soundings["quality"] == 0]
    pings = survey.pings.iloc[soundings["ping"]]
    x, y = (soundings[name].to_numpy() - pings[name].to_numpy() for name in ("x_m", "y_m"))
    yaw = pings["yaw_rad"].to_numpy()
    along, port = x * np.cos(yaw) + y * np.sin(yaw), y * np.cos(yaw) - x * np.sin(yaw)
    port = -port if mirrored else port
    x = pings["x_m"].to_numpy() + along * np.cos(yaw) - port * np.sin(yaw)
    y = pings["y_m"].to_numpy() + along * np.sin(yaw) + port * np.cos(yaw)
    table = soundings.assign(cell_x=x // 50, cell_y=y // 50)
    medians = table.groupby(["cell_x", "cell_y", "ping"])["z_m"].median()
    return float(medians.groupby(level=["cell_x", "cell_y"]).std().median())


@real
@pytest.mark.parametrize("name", REAL[:2])
def test_neighbouring_pings_agree_on_the_seabed_and_would_not_if_port_were_starboard(name: str):
    survey = whole_survey.read(GSF / name)
    assert disagreement(survey, mirrored=False) < 0.9 * disagreement(survey, mirrored=True)
