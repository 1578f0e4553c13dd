"""Simulated lines as Kongsberg .all files, which other programs read (Kongsberg's document 160692).

A file has the installation (I), runtime parameters (R), a position (P) and an XYZ 88 datagram (X) at every ping, and
attitudes (A) at the times of pings. Bytes are in little-endian order. A position is rounded to 5e-8 degree of latitude
and 1e-7 of longitude (6 and 11 mm at the equator), a time to 1 ms, heading, roll and pitch to 0.01 degree. Soundings
are relative to the rounded heading, so that it does not move them. The vehicle's depth is that of the transmit
transducer in X, below the water line; programs that place every sonar at the surface show depths below the vehicle.

What a simulated line has not: the serial number is 0. Speed and course are marked as not available. Fix quality, a
beam's window, quality factor and reflectivity, the sampling rate, and all runtime parameters but the equidistant beams
are 0. Simulated beams are straight, so the water has one speed of sound, and any would do: the files have 1500 m/s.
"""

import datetime
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.simulation import Line
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError

_MODEL, _SERIAL = 2040, 0  # the simulated vehicles have an EM2040
_SOUND = 15_000  # 0.1 m/s
_UNKNOWN = 0xFFFF
_USED_POSITION, _USED_ATTITUDE = 0x81, 0x01  # system 1, active; sensor 1, all of it, with heading
_VALID = 0x9090  # an attitude sensor's status
_DETECTED, _REJECTED, _NOTHING = 0x00, 0x83, 0x84  # of a beam's detection: by amplitude; a rejected candidate; none
_FLAGGED = -1  # by the cleaning in real time
_ATTITUDES_S = 10.0  # in one datagram, whose times are 16 bits of milliseconds
_STEP_M = 10.0  # for differences: small against the earth, large against rounding
_EQUIDISTANT = 1
# status and mode (6 x 1 byte), depths, absorption, pulse and beam width (5 x 2), 6 of power and receiver; swath, and on
_RUNTIME = struct.pack("<6B5Hb5BH4BHhB", *[0] * 18, _EQUIDISTANT, *[0] * 6)
_BEAM = np.dtype(
    {
        "names": ["down", "across", "along", "window", "factor", "adjusted", "detection", "cleaning", "reflectivity"],
        "formats": ["<f4", "<f4", "<f4", "<u2", "u1", "i1", "u1", "i1", "<i2"],
    }
)
_SAMPLE = np.dtype(
    [("ms", "<u2"), ("status", "<u2"), ("roll", "<i2"), ("pitch", "<i2"), ("heave", "<i2"), ("heading", "<u2")]
)
# All sensors are at the vehicle's reference point, and look along its axes: every offset is 0. Positions are by system
# 1, heading and attitude by motion sensor 1 (2 in the parameters), as the simulation has only one of each.
_OFFSETS = ",".join(
    [f"{sensor}{axis}=0.000" for sensor in ("S1", "S2", "MS") for axis in "XYZ"]
    + [f"{sensor}{angle}=0.000" for sensor in ("S1", "S2") for angle in "HPR"]
    + [f"MS{angle}=0.000" for angle in "RPG"]
    + ["MSD=0,MRP=RP,P1M=0,P1T=0,P1Q=1,P1X=0.000,P1Y=0.000,P1Z=0.000,P1D=0.000,P1G=WGS84"]
    + ["GCG=0.000,APS=0,AHS=2,ARO=2,AHE=2"]
)


class KongsbergFileError(PointNetKLError):
    """A line cannot be written as a .all file."""


@dataclass(frozen=True)
class _Track:
    """The pings of a line; arrays (n,) in the units of the datagrams."""

    ms: np.ndarray  # UTC since 1970
    longitude: np.ndarray
    latitude: np.ndarray
    heading: np.ndarray  # clockwise from true north
    roll: np.ndarray
    pitch: np.ndarray
    depth_m: np.ndarray


def name(number: int, line: Line) -> str:
    """Return a line's file name as the sonar's own program has it: number, date, time, vehicle."""
    begin = datetime.datetime.fromtimestamp(int(line.raw["time_s"].iloc[0]), datetime.UTC)
    return f"{number:04d}_{begin:%Y%m%d_%H%M%S}_auv.all"


def write(path: Path, line: Line, crs: str, number: int = 0) -> None:
    """Write a line, whose coordinates are in a projected CRS, and its number in the survey.

    Raises:
        KongsbergFileError: the line has no sounding, or the CRS is not a map in metres that holds it.
        ArtifactError: the file cannot be written.
    """
    if line.raw.empty:
        raise KongsbergFileError(f"{path}: its line has no sounding, so there is nothing to write")
    _, first, ping = np.unique(line.raw["time_s"].to_numpy(), return_index=True, return_inverse=True)
    pings = line.raw.iloc[first]
    longitude, latitude, T_map_ground = _on_earth(path, crs, *(pings[axis].to_numpy() for axis in ("x_m", "y_m")))
    T_ground_map = np.linalg.inv(T_map_ground)
    track = _track(pings, longitude, latitude, T_ground_map)
    beams = _beams(line.raw, ping, track.heading, T_ground_map)
    artifacts.write_bytes(path, b"".join(_datagrams(path.name, number, track, beams)))


def _on_earth(path: Path, crs: str, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return longitudes, latitudes (n,) in degrees, and (n, 2, 2) that take metres east and north on the ground to map.

    The latter has the map's scale and its turn (meridian convergence).
    """
    from pyproj import CRS, Geod, Transformer
    from pyproj.exceptions import CRSError

    try:
        projected = CRS.from_user_input(crs)
    except CRSError as error:
        raise KongsbergFileError(f"{path}: the CRS {crs!r} is unknown, must be such as EPSG:32633") from error
    if not projected.is_projected or any(axis.unit_name != "metre" for axis in projected.axis_info):
        raise KongsbergFileError(f"{path}: the CRS {crs} is not a map in metres; take a UTM zone")
    to_map = Transformer.from_crs("EPSG:4326", projected, always_xy=True)
    longitude, latitude = to_map.transform(x, y, direction="INVERSE")
    columns = []
    for azimuth in (90.0, 0.0):
        beside = Geod(ellps="WGS84").fwd(longitude, latitude, np.full(len(x), azimuth), np.full(len(x), _STEP_M))
        beside_x, beside_y = to_map.transform(*beside[:2])
        columns.append(np.stack([beside_x - x, beside_y - y], axis=1) / _STEP_M)
    T_map_ground = np.stack(columns, axis=2)
    if not np.isfinite(T_map_ground).all():
        raise KongsbergFileError(f"{path}: {crs} does not reach all positions of the line")
    return longitude, latitude, T_map_ground


def _track(pings: pd.DataFrame, longitude: np.ndarray, latitude: np.ndarray, T_ground_map: np.ndarray) -> _Track:
    forward = np.stack([np.sin(pings["heading_rad"]), np.cos(pings["heading_rad"])], axis=1)
    east, north = np.einsum("nij,nj->in", T_ground_map, forward)
    heading = np.round(np.rad2deg(np.arctan2(east, north)) * 100) % 36_000
    roll, pitch = (np.round(np.rad2deg(pings[angle].to_numpy()) * 100) for angle in ("roll_rad", "pitch_rad"))
    places = (np.round(longitude * 1e7).astype(int), np.round(latitude * 2e7).astype(int))
    ms = np.round(pings["time_s"].to_numpy() * 1000).astype(np.int64)
    return _Track(ms, *places, heading.astype(int), roll, pitch, pings["depth_m"].to_numpy())


def _beams(raw: pd.DataFrame, ping: np.ndarray, heading: np.ndarray, T_ground_map: np.ndarray) -> np.ndarray:
    """Return the beams (pings, beams) of a line; those without a sounding are not detected."""
    along, across, sin, cos = (
        *(raw[axis].to_numpy(np.float64) for axis in ("along_m", "across_m")),
        *(f(raw["heading_rad"].to_numpy()) for f in (np.sin, np.cos)),
    )
    on_map = np.stack([along * sin + across * cos, along * cos - across * sin], axis=1)
    east, north = np.einsum("nij,nj->in", T_ground_map[ping], on_map)
    true = np.deg2rad(heading[ping] / 100)
    beam, rejected = raw["beam"].to_numpy(), raw["quality"].to_numpy() != 0
    beams = np.zeros((len(heading), int(beam.max()) + 1), _BEAM)
    beams["detection"] = _NOTHING
    beams["down"][ping, beam] = raw["down_m"]
    beams["along"][ping, beam] = east * np.sin(true) + north * np.cos(true)
    beams["across"][ping, beam] = east * np.cos(true) - north * np.sin(true)
    beams["detection"][ping, beam] = np.where(rejected, _REJECTED, _DETECTED)
    beams["cleaning"][ping, beam] = np.where(rejected, _FLAGGED, 0)
    return beams


def _datagrams(file: str, number: int, track: _Track, beams: np.ndarray) -> Iterator[bytes]:
    text = f"WLZ=0.000,SMH={_SERIAL},STC=0,{_OFFSETS},RFN={file},"
    yield _datagram("I", struct.pack("<H", 0) + text.encode(), int(track.ms[0]), number)
    yield _datagram("R", _RUNTIME, int(track.ms[0]), 0)
    counts = np.sum(beams["detection"] == _DETECTED, axis=1)
    group = (track.ms - track.ms[0]) // int(_ATTITUDES_S * 1000)
    for k, ms in enumerate(track.ms.tolist()):
        if k == 0 or group[k] != group[k - 1]:
            rows = np.flatnonzero(group == group[k])
            yield _datagram("A", _attitudes(track, rows), ms, k)
        place = (track.latitude[k], track.longitude[k], 0, _UNKNOWN, _UNKNOWN, track.heading[k], _USED_POSITION, 0)
        yield _datagram("P", struct.pack("<iiHHHHBB", *place), ms, k)
        head = (track.heading[k], _SOUND, track.depth_m[k], beams.shape[1], counts[k], 0.0, 0)
        yield _datagram("X", struct.pack("<HHfHHfB3x", *head) + beams[k].tobytes(), ms, k)


def _attitudes(track: _Track, rows: np.ndarray) -> bytes:
    samples = np.zeros(len(rows), _SAMPLE)
    samples["ms"], samples["status"] = track.ms[rows] - track.ms[rows[0]], _VALID
    for angle in ("roll", "pitch", "heading"):
        samples[angle] = getattr(track, angle)[rows]
    return struct.pack("<H", len(rows)) + samples.tobytes() + bytes([_USED_ATTITUDE])


def _datagram(kind: str, content: bytes, ms: int, counter: int) -> bytes:
    """Return a datagram with its length before it and its checksum behind; a length is even, by a spare byte."""
    day = datetime.datetime.fromtimestamp(ms // 1000, datetime.UTC)
    date = day.year * 10_000 + day.month * 100 + day.day
    head = struct.pack("<BHIIHH", ord(kind), _MODEL, date, ms % 86_400_000, counter & 0xFFFF, _SERIAL)
    inner = head + content + bytes(1 - len(content) % 2)
    checksum = int(np.frombuffer(inner, np.uint8).sum(dtype=np.uint32)) & 0xFFFF
    return struct.pack("<IB", len(inner) + 4, 2) + inner + struct.pack("<BH", 3, checksum)
