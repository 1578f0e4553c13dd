"""Simulated lines as .all files: any reader finds the pings and soundings where the simulation has them."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pyproj
import pytest

from pointnetkl import readers, simulation
from pointnetkl.readers.formats import kongsberg_all
from pointnetkl.readers.formats.recording import IMPOSSIBLE, REJECTED
from pointnetkl.simulation import kongsberg_files, seabed, vehicle
from pointnetkl.simulation.kongsberg_files import KongsbergFileError
from pointnetkl.workflow import parameters
from simulated_survey import PARAMS, georeferenced, short_line

# Maps that turn and stretch the ground: near the edge of a UTM zone, south of the equator, and about a pole.
PLACES = {
    "EPSG:32632": (780_000.0, 6_450_000.0),
    "EPSG:32756": (240_000.0, 6_250_000.0),
    "EPSG:3031": (-1_560_000.0, -480_000.0),
}
CRS = "EPSG:32632"


def sail(crs: str = CRS, lines: int = 1) -> list[simulation.Line]:
    """Return lines of 60 m at a place of the CRS, by a vehicle that sways, drifts and misses soundings."""
    settings = short_line()
    layout = dataclasses.replace(settings.layout, lines=lines, azimuth_deg=35.0)
    settings = dataclasses.replace(settings, layout=layout)
    sailing = parameters.read(PARAMS, "vehicles.hugin", vehicle.Settings)
    sonar = dataclasses.replace(sailing.sonar, dropouts=0.05, outliers=0.05, flagged=0.5)
    ground = seabed.Random(settings.terrain, settings.seed, crs, PLACES[crs])
    return list(simulation.survey(settings, dataclasses.replace(sailing, sonar=sonar), ground))


def written(folder: Path, lines: list[simulation.Line], crs: str = CRS) -> list[Path]:
    """Return the files of the lines."""
    files = [folder / kongsberg_files.name(number, line) for number, line in enumerate(lines, start=1)]
    for number, (file, line) in enumerate(zip(files, lines, strict=True), start=1):
        kongsberg_files.write(file, line, crs, number)
    return files


def read(file: Path) -> kongsberg_all.Recording:
    """Return a file's only recording."""
    (recording,) = kongsberg_all.read(file)
    return recording


def numbered(raw: pd.DataFrame) -> pd.DataFrame:
    """Return raw soundings with the numbers of their pings."""
    return raw.assign(ping=np.unique(raw["time_s"], return_inverse=True)[1])


def pings_of(raw: pd.DataFrame) -> pd.DataFrame:
    """Return a row of raw soundings for each ping."""
    return raw.drop_duplicates("time_s").reset_index(drop=True)


@pytest.mark.parametrize("crs", PLACES)
def test_our_reader_places_pings_and_soundings_as_the_simulation_does(tmp_path: Path, crs: str):
    lines = sail(crs, 2)
    written(tmp_path, lines, crs)
    parts: list[pd.DataFrame] = []
    survey = readers.read(tmp_path, readers.Settings(crs), parts.append)
    raw, soundings = pd.concat([line.raw for line in lines]), pd.concat(parts)
    raw = numbered(raw).reset_index(drop=True)
    pings = pings_of(raw)
    assert survey.crs == crs
    assert survey.report["problems"] == []
    np.testing.assert_allclose(survey.pings["time_s"], pings["time_s"], rtol=0, atol=5.1e-4)
    np.testing.assert_allclose(survey.pings["x_m"] + survey.origin[0], pings["x_m"], rtol=0, atol=0.01)
    np.testing.assert_allclose(survey.pings["y_m"] + survey.origin[1], pings["y_m"], rtol=0, atol=0.01)
    np.testing.assert_allclose(survey.pings["z_m"], -pings["depth_m"], rtol=0, atol=1e-4)
    joined = pd.concat([raw, pd.DataFrame(georeferenced(raw), columns=["east", "north", "up"])], axis=1).merge(
        soundings, on=["ping", "beam"], suffixes=("", "_read"), validate="one_to_one"
    )
    assert len(joined) == len(raw)
    np.testing.assert_allclose(joined["x_m_read"] + survey.origin[0], joined["east"], rtol=0, atol=0.01)
    np.testing.assert_allclose(joined["y_m_read"] + survey.origin[1], joined["north"], rtol=0, atol=0.01)
    np.testing.assert_allclose(joined["z_m"], joined["up"], rtol=0, atol=1e-3)


def test_attitudes_stand_at_the_times_of_pings(tmp_path: Path):
    (line,) = sail()
    recording = read(*written(tmp_path, [line]))
    pings = pings_of(line.raw)
    for angle in ("roll_rad", "pitch_rad"):
        np.testing.assert_allclose(np.rad2deg(recording.pings[angle] - pings[angle]), 0, atol=0.0051)


@pytest.mark.parametrize("crs", PLACES)
def test_headings_are_from_true_north_not_from_the_grid(tmp_path: Path, crs: str):
    (line,) = sail(crs)
    recording = read(*written(tmp_path, [line], crs))
    place = recording.pings[["east", "north"]].to_numpy().T
    convergence = pyproj.Proj(crs).get_factors(*place).meridian_convergence
    apart = np.rad2deg(recording.pings["heading_rad"] - pings_of(line.raw)["heading_rad"]) - convergence
    assert np.abs(convergence).min() > 1
    np.testing.assert_allclose(np.mod(apart + 180, 360) - 180, 0, atol=0.0051)


def test_rejected_soundings_are_flagged_and_beams_without_a_sounding_are_not_detected(tmp_path: Path):
    (line,) = sail()
    recording = read(*written(tmp_path, [line]))
    key = ["ping", "beam"]
    simulated, found = (table.set_index(key)["quality"] for table in (numbered(line.raw), recording.soundings))
    assert set(found[found == REJECTED].index) == set(simulated[simulated != 0].index)
    assert set(found[found == IMPOSSIBLE].index) == set(found.index) - set(simulated.index)
    assert {0, REJECTED, IMPOSSIBLE} == set(found)


def test_a_line_over_midnight_keeps_its_times(tmp_path: Path):
    (line,) = sail()
    shift = 86_400.0 - line.raw["time_s"].iloc[0] % 86_400 - 15.0
    late = simulation.Line(line.raw.assign(time_s=line.raw["time_s"] + shift), line.truth)
    recording = read(*written(tmp_path, [late]))
    np.testing.assert_allclose(recording.pings["time_s"], pings_of(late.raw)["time_s"], rtol=0, atol=5.1e-4)
    assert recording.pings["roll_rad"].notna().all()
    assert recording.pings["east"].notna().all()


def test_names_have_number_and_time_and_sort_as_lines_were_sailed():
    names = [kongsberg_files.name(number, line) for number, line in enumerate(sail(lines=2), start=1)]
    assert names[0] == "0001_20200913_122640_auv.all"
    assert names == sorted(names)


def test_the_same_line_gives_the_same_bytes(tmp_path: Path):
    first, second = (written(tmp_path / name, sail())[0].read_bytes() for name in ("first", "second"))
    assert first == second


@pytest.mark.parametrize(
    ("crs", "cause"),
    [("EPSG:4326", "not a map in metres"), ("local", "is unknown"), ("EPSG:2225", "not a map in metres")],
)
def test_a_crs_that_is_no_map_in_metres_is_refused(tmp_path: Path, crs: str, cause: str):
    (line,) = sail()
    with pytest.raises(KongsbergFileError, match=cause):
        kongsberg_files.write(tmp_path / "line.all", line, crs)
    assert not list(tmp_path.iterdir())


def test_places_off_the_map_are_refused(tmp_path: Path):
    (line,) = sail()
    far = simulation.Line(line.raw.assign(x_m=1e9), line.truth)
    with pytest.raises(KongsbergFileError, match="does not reach"):
        kongsberg_files.write(tmp_path / "line.all", far, CRS)


def test_a_line_without_soundings_is_refused(tmp_path: Path):
    (line,) = sail()
    with pytest.raises(KongsbergFileError, match="no sounding"):
        kongsberg_files.write(tmp_path / "line.all", simulation.Line(line.raw[:0], line.truth), CRS)


def test_an_independent_reader_finds_every_ping_and_sounding(tmp_path: Path):
    kongsbergall = pytest.importorskip("themachinethatgoesping.echosounders.kongsbergall")
    (line,) = sail()
    handler = kongsbergall.KongsbergAllFileHandler(list(map(str, written(tmp_path, [line]))), show_progress=False)
    theirs = handler.get_pings()
    soundings = handler.datagram_interface.datagrams(kongsbergall.t_KongsbergAllDatagramIdentifier.XYZDatagram)
    raw, pings = numbered(line.raw), pings_of(line.raw)
    raw = raw.assign(**dict(zip(("east", "north", "up"), georeferenced(raw).T, strict=True)))
    to_map = pyproj.Transformer.from_crs("EPSG:4326", CRS, always_xy=True)
    assert len(theirs) == len(soundings) == len(pings)
    for number, (ping, datagram) in enumerate(zip(theirs, soundings, strict=True)):
        assert ping.get_timestamp() == pytest.approx(pings["time_s"][number], abs=6e-4)
        place, vehicle_depth = ping.get_geolocation(), datagram.get_transmit_transducer_depth()
        factors = pyproj.Proj(CRS).get_factors(place.longitude, place.latitude)
        x, y = to_map.transform(place.longitude, place.latitude)
        turn = np.deg2rad(place.yaw - factors.meridian_convergence)
        beams, own = ping.bottom.get_xyz(), raw[raw["ping"] == number]
        along, across, down = (np.array(axis, np.float64)[own["beam"]] for axis in (beams.x, beams.y, beams.z))
        east, north = along * np.sin(turn) + across * np.cos(turn), along * np.cos(turn) - across * np.sin(turn)
        np.testing.assert_allclose(x + factors.meridional_scale * east, own["east"], rtol=0, atol=0.02)
        np.testing.assert_allclose(y + factors.meridional_scale * north, own["north"], rtol=0, atol=0.02)
        np.testing.assert_allclose(-(vehicle_depth + down), own["up"], rtol=0, atol=1e-3)
        assert datagram.get_number_of_valid_detections() == np.sum(own["quality"] == 0)
