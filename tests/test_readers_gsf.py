"""GSF: the sonar's own numbers, port and starboard the right way round, and damage that costs only what it hit."""

from pathlib import Path
from typing import Any

import GSFU
import numpy as np
import pytest

from conftest import REALDATA
from pointnetkl import readers
from pointnetkl.survey import Survey, track_length
from test_readers import mutated, outcome_of

GSF = REALDATA / "gsf"
real = pytest.mark.skipif(not GSF.exists(), reason="no real data here")
BEAMS = np.linspace(-40, 40, 21)


def written(path: Path, pings: int = 12, **fields: Any) -> Path:
    """Write a small GSF file: a ship heading east at 10 N, the seabed 50 m deep to port and 40 m to starboard."""
    file = GSFU.gsf(str(path))
    file.write_header()
    for number in range(pings):
        ping = GSFU.gsfu.new_swath_bathymetry_ping()
        ping |= {"PingTime": 1.4e9 + number, "Longitude_deg": 5.0 + 1e-5 * number, "Latitude_deg": 10.0}
        ping |= {"NumberBeams": len(BEAMS), "Heading_deg": 90.0, "Roll_deg": 1.0, "Pitch_deg": -1.0} | fields
        beams = {"Depth_m": 45.0 - BEAMS / 8, "AcrossTrack_m": BEAMS, "AlongTrack_m": np.full(len(BEAMS), 2.0)}
        ping["Beams"] |= beams | {"BeamFlags": (np.arange(len(BEAMS)) == 3).astype(np.uint8)}
        file.write_swath_bathymetry_ping(ping)
    file.closeFile()
    return path


def places_of_pings(path: Path) -> list[int]:
    """Return the byte at which each ping's record begins."""
    file = GSFU.gsf(str(path))
    places = [offset for _, offset, _ in file.iter_records("SWATH_BATHYMETRY_PING")]
    file.closeFile()
    return places


def test_a_written_ping_is_read_where_it_was(tmp_path: Path):
    survey = readers.read(written(tmp_path / "small.gsf"), "auto")
    assert survey.crs == "EPSG:32631"
    assert survey.report["valid"] == 12 * 20
    ping = survey.soundings[survey.soundings["ping"] == 0]
    offset = ping[["x_m", "y_m"]].to_numpy() - survey.pings[["x_m", "y_m"]].to_numpy()[0]
    # the grid's north is 0.35 degrees off there, which turns 40 m by 0.24 m
    np.testing.assert_allclose(offset, np.stack([np.full(21, 2.0), -BEAMS], 1), atol=0.3)
    np.testing.assert_allclose(ping["z_m"], BEAMS / 8 - 45, atol=0.01)
    np.testing.assert_allclose(survey.pings[["roll_rad", "pitch_rad"]][:1], np.deg2rad([[1, -1]]))
    assert survey.pings["time_s"][5] == pytest.approx(1.4e9 + 5)


def test_depth_holds_the_vehicle_s_depth_already(tmp_path: Path):
    ship = readers.read(written(tmp_path / "ship.gsf"), "auto")
    vehicle = readers.read(written(tmp_path / "vehicle.gsf", DepthCorrector_m=30.0), "auto")
    assert ship.pings["z_m"].eq(0).all()
    assert vehicle.pings["z_m"].eq(-30).all()
    np.testing.assert_allclose(ship.soundings["z_m"], vehicle.soundings["z_m"])


def test_a_rejected_ping_rejects_its_soundings_and_one_without_position_is_skipped(tmp_path: Path):
    assert readers.read(written(tmp_path / "a.gsf", PingFlags=1), "auto").report["valid"] == 0
    with pytest.raises(readers.SurveyError, match="12 pings without a position"):
        readers.read(written(tmp_path / "b.gsf", Longitude_deg=181.0, Latitude_deg=91.0), "auto")
    with pytest.raises(readers.SurveyError, match="12 pings without a heading"):
        readers.read(written(tmp_path / "c.gsf", Heading_deg=361.0), "auto")


def test_a_file_is_known_by_its_content_whatever_its_name(tmp_path: Path):
    assert len(readers.read(written(tmp_path / "line.d01"), "auto").pings) == 12


def test_a_file_that_was_cut_off_gives_what_stands_before_and_says_where(tmp_path: Path):
    path = written(tmp_path / "small.gsf")
    cut = places_of_pings(path)[7]
    path.write_bytes(path.read_bytes()[: cut + 30])
    survey = readers.read(path, "auto")
    assert len(survey.pings) == 7
    assert survey.report["problems"] == [f"small.gsf: 30 bytes from byte {cut} on are damaged or cut off"]


def test_a_damaged_length_costs_its_record_alone(tmp_path: Path):
    path = written(tmp_path / "small.gsf")
    content, places = bytearray(path.read_bytes()), places_of_pings(path)
    content[places[5]] = 0x7F
    path.write_bytes(content)
    survey = readers.read(path, "auto")
    assert list(survey.pings["time_s"] - 1.4e9) == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert f"from byte {places[5]}" in survey.report["problems"][0]


def test_a_checksum_that_does_not_match_costs_the_ping(tmp_path: Path):
    source, path = written(tmp_path / "small.gsf"), tmp_path / "sums.gsf"
    file, target = source.read_bytes(), GSFU.gsf(str(path))
    target.write_header()
    for number, at in enumerate(places_of_pings(source)):
        size = int.from_bytes(file[at : at + 4], "big")
        target.write_record(2, file[at + 8 : at + 8 + size], checksum=True)
        end = target.FID.tell()
        if number == 4:
            target.FID.seek(end - 20)
            target.FID.write(b"\x55")
            target.FID.seek(end)
    target.closeFile()
    survey = readers.read(path, "auto")
    assert len(survey.pings) == 11
    assert survey.report["skipped"] == {"unreadable pings": 1}
    assert "checksum" in survey.report["problems"][0]


def test_depths_are_not_read_with_scale_factors_that_may_be_lost(tmp_path: Path):
    path = written(tmp_path / "small.gsf")
    content, places = bytearray(path.read_bytes()), places_of_pings(path)
    content[places[3] + 8 + 56 + 1] = 0xFF  # the length of the scale factors themselves
    for at in places[4:]:
        content[at + 8 + 56] = 99  # the pings behind have none: theirs become parts of unknown kind
    path.write_bytes(content)
    survey = readers.read(path, "auto")
    assert len(survey.pings) == 3
    assert survey.report["skipped"] == {"unreadable pings": 9}
    assert "no scale factors" in survey.report["problems"][-1]


def test_mutated_files_end_in_a_sentence_or_in_finite_soundings(tmp_path: Path):
    rng = np.random.default_rng(0)
    source = GSF / "em302_deep.gsf" if GSF.exists() else written(tmp_path / "small.gsf")
    small = written(tmp_path / "other.gsf", pings=4).read_bytes()
    content = source.read_bytes()
    told = [outcome_of(tmp_path / "mutated.gsf", mutated(content, rng)) for _ in range(60)]
    told += [outcome_of(tmp_path / "mutated.gsf", mutated(small, rng)) for _ in range(140)]
    assert "" in told
    assert any(told)


def test_garbage_behind_a_good_beginning_does_not_hang(tmp_path: Path):
    content = written(tmp_path / "small.gsf").read_bytes()
    noise = np.random.default_rng(1).integers(0, 256, 1 << 20, dtype=np.uint8).tobytes()
    for filling in (noise, bytes(1 << 20), b"\x00\x00\x00\x02" * (1 << 18)):
        (tmp_path / "small.gsf").write_bytes(content + filling)
        assert len(readers.read(tmp_path / "small.gsf", "auto").pings) == 12


@real
def test_the_real_survey_has_the_counts_that_are_known():
    survey = readers.read(GSF / "em302_st_croix.gsf", "auto")
    good = -survey.soundings["z_m"][survey.soundings["quality"] == 0]
    assert (len(survey.pings), len(survey.soundings), len(good)) == (50, 21_600, 20_959)
    assert survey.report["skipped"] == {}
    assert track_length(survey.pings) == pytest.approx(1247, rel=0.004)  # on the ellipsoid it is 1243
    assert np.ptp(survey.pings["time_s"]) == pytest.approx(298, abs=1)
    np.testing.assert_allclose(good.quantile([0.01, 0.99]), [1244, 2291], atol=1)


@real
def test_the_deep_survey_and_the_stub_have_the_counts_that_are_known():
    deep = readers.read(GSF / "em302_deep.gsf", "auto")
    assert (len(deep.pings), len(deep.soundings)) == (8, 8 * 432)
    assert -deep.soundings["z_m"].median() == pytest.approx(4060, abs=40)
    stub = readers.read(GSF / "stub_3_09.gsf", "auto")
    assert (len(stub.pings), len(stub.soundings), stub.report["valid"]) == (3, 21, 0)


def disagreement(survey: Survey, mirrored: bool) -> float:
    """Return the median difference in depth of soundings of different pings in one cell, metres."""
    soundings = survey.soundings[survey.soundings["quality"] == 0]
    pings = survey.pings.iloc[soundings["ping"]]
    x, y = (soundings[name].to_numpy() - pings[name].to_numpy() for name in ("x_m", "y_m"))
    yaw = pings["yaw_rad"].to_numpy()
    along, left = x * np.cos(yaw) + y * np.sin(yaw), y * np.cos(yaw) - x * np.sin(yaw)
    left = -left if mirrored else left
    x = pings["x_m"].to_numpy() + along * np.cos(yaw) - left * np.sin(yaw)
    y = pings["y_m"].to_numpy() + along * np.sin(yaw) + left * np.cos(yaw)
    table = soundings.assign(cell_x=x // 50, cell_y=y // 50)
    each = table.groupby(["cell_x", "cell_y", "ping"])["z_m"].median()
    return float(each.groupby(level=["cell_x", "cell_y"]).std().median())


@real
@pytest.mark.parametrize("name", ["em302_st_croix.gsf", "em302_deep.gsf"])
def test_neighbouring_pings_agree_on_the_seabed_and_would_not_if_port_were_starboard(name: str):
    survey = readers.read(GSF / name, "auto")
    assert disagreement(survey, mirrored=False) < 0.9 * disagreement(survey, mirrored=True)
