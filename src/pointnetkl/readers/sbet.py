"""SBET, the smoothed best estimate of a trajectory (Applanix POSPac): post-processed navigation for a survey's pings.

A record is 17 little-endian doubles, 136 bytes, and there is no header: time (s of the GPS week), latitude, longitude
(rad, WGS84), altitude (m above the ellipsoid), 3 velocities in the wander frame (m/s), roll, pitch, platform heading,
wander angle (rad), 3 accelerations, 3 angular rates. Heading from true north is platform heading less wander angle.
Times are GPS time unless the user has exported UTC; at the end of a week they continue or begin again at zero.
"""

import datetime
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.readers.formats import interpolation
from pointnetkl.readers.formats.window import Window
from pointnetkl.surveys.survey import SurveyError

SUFFIXES = (".sbet", ".out")

GPS, UTC = "gps", "utc"  # clocks of a file's seconds of the week

_DOUBLES, _BYTES = 17, 136
_KEPT = (0, 1, 2, 3, 7, 8, 9, 10)  # time, latitude, longitude, altitude, roll, pitch, heading, wander
_ARRAYS = ("time_s", "east", "north", "height_m", "roll_rad", "pitch_rad", "heading_rad")
_BATCH = 1 << 16  # records read at once
_EVERY_S = 0.02  # denser records are thinned: a day at 200 Hz is 2.3 GB, and no vehicle turns that fast
_WEEK_S, _GPS_EPOCH_S = 604_800.0, 315_964_800  # the epoch, 6 January 1980, in UTC seconds since 1970
_LEAPS = {1999: 13, 2006: 14, 2009: 15, 2012.5: 16, 2015.5: 17, 2017: 18}  # GPS minus UTC, from each year on
_GAP_S = 1.0  # between samples, across which navigation is interpolated
_NEAR_S, _SHORTEST_S = 10.0, 1e-4  # between records that follow each other
_HIGHEST_M, _FASTEST_M_S, _STEEPEST_RAD, _TURN_RAD = 2e4, 500.0, 1.3, 13.0


class SbetError(SurveyError):
    """A file is not SBET, or its times cannot be those of the survey."""


@dataclass(frozen=True)
class Navigation:
    """Position and attitude at n times, at most 50 a second; arrays (n,)."""

    file: str
    time_s: np.ndarray  # UTC since 1970; from `read_week` seconds of the week, by the file's clock
    east: np.ndarray  # longitude, degrees
    north: np.ndarray  # latitude, degrees
    height_m: np.ndarray  # above the ellipsoid
    roll_rad: np.ndarray
    pitch_rad: np.ndarray
    heading_rad: np.ndarray  # clockwise from true north
    skipped: int = 0  # records that no vehicle can have
    problems: list[str] = field(default_factory=list)


def begins(head: bytes) -> bool:
    """Whether the first bytes of a file are credible records in the order of time."""
    records = np.frombuffer(head, "<f8", len(head) // _BYTES * _DOUBLES).reshape(-1, _DOUBLES)
    # one record is not enough: a text of numbers may pass for one
    if len(records) < 2 or not (np.isfinite(records).all() and _credible(records).all()):
        return False
    steps = np.diff(records[:, 0])
    follows = (steps >= _SHORTEST_S) & (steps <= _NEAR_S)
    return bool((follows | (steps <= _NEAR_S - _WEEK_S)).all())  # or begins again at zero


def read(path: Path, week_of_s: float, clock: str = GPS) -> Navigation:
    """Read an SBET file of the week that contains the survey's time `week_of_s` (UTC, seconds since 1970).

    Raises:
        SbetError: no record is credible, the file cannot be read, or the survey is from before 1999.
        ValueError: clock is neither gps nor utc.
    """
    if clock not in (GPS, UTC):
        raise ValueError(f"clock is {clock!r}, must be {GPS} or {UTC}")
    leap_s = _leap_seconds(path, week_of_s) if clock == GPS else 0
    week = read_week(path)
    return replace(week, time_s=week.time_s + _week_start(week.time_s, week_of_s + leap_s) - leap_s)


def read_week(path: Path) -> Navigation:
    """Read an SBET file; times are seconds of the week in which it begins, and exceed a week after that week's end.

    Raises:
        SbetError: no record is credible, or the file cannot be read.
    """
    records, count, skipped, cut = _records(path)
    if not len(records):
        raise SbetError(f"{path}: none of {count} records from byte 0 on is of a vehicle's navigation; is it SBET?")
    time, lat, lon, height, roll, pitch, platform, wander = records.T
    time = time % _WEEK_S if time[0] >= _WEEK_S else time
    time = time + _WEEK_S * np.cumsum(np.diff(time, prepend=time[0]) < -_WEEK_S / 2)
    problems = [f"{path.name}: {cut} bytes from byte {_BYTES * count} on are cut off"] if cut else []
    degrees = np.rad2deg(lon), np.rad2deg(lat)
    heading = np.mod(platform - wander, 2 * np.pi)
    return Navigation(path.name, time, *degrees, height, roll, pitch, heading, skipped, problems)


def around(navigation: Navigation, begin_s: float, end_s: float) -> Navigation:
    """Return the records that pings between two times need."""
    near = (navigation.time_s >= begin_s - _GAP_S) & (navigation.time_s <= end_s + _GAP_S)
    arrays = {name: getattr(navigation, name)[near] for name in _ARRAYS}
    return replace(navigation, **arrays)


def apply(pings: pd.DataFrame, navigation: Navigation) -> tuple[pd.DataFrame, int]:
    """Return pings (recording.PING_COLUMNS) with position and attitude of the navigation, and how many it lacks.

    Pings at times without navigation are left out; the others keep their index. Depths stay the sonar's own.
    """
    time, samples = pings["time_s"].to_numpy(), navigation.time_s
    placed = pings.assign(
        east=interpolation.longitude(time, samples, navigation.east, _GAP_S),
        north=interpolation.linear(time, samples, navigation.north, _GAP_S),
        roll_rad=interpolation.linear(time, samples, navigation.roll_rad, _GAP_S),
        pitch_rad=interpolation.linear(time, samples, navigation.pitch_rad, _GAP_S),
        heading_rad=interpolation.angle(time, samples, navigation.heading_rad, _GAP_S),
    )
    complete = np.isfinite(placed[["east", "north", "heading_rad"]].to_numpy()).all(1)
    return placed[complete], int(np.sum(~complete))


def _records(path: Path) -> tuple[np.ndarray, int, int, int]:
    """Return records (n, 8) of _KEPT, the count of all, the count of incredible ones, and the bytes after the last."""
    kept, credible, step = [np.empty((0, len(_KEPT)))], 0, 0
    try:
        with Window(path) as window:
            count, cut = divmod(window.size, _BYTES)
            for first in range(0, count, _BATCH):
                content = window.read(first * _BYTES, min(_BATCH, count - first) * _BYTES)
                records = np.frombuffer(content, "<f8").reshape(-1, _DOUBLES)
                records = records[_credible(records)][:, _KEPT]
                records = records[~_lonely(records[:, 0])]
                step = step or _thinning(records[:, 0])
                kept.append(records[-credible % max(step, 1) :: max(step, 1)].copy())  # a view would keep them all
                credible += len(records)
    except OSError as error:
        raise SbetError(f"{path}: cannot be read ({error.strerror})") from error
    return np.concatenate(kept), count, count - credible, cut


def _thinning(time: np.ndarray) -> int:
    """Return k if every k-th record is kept; 0 where there are too few records to say."""
    return max(1, round(_EVERY_S / max(float(np.median(np.diff(time))), _SHORTEST_S))) if len(time) > 1 else 0


def _credible(records: np.ndarray) -> np.ndarray:
    """Return which records (n, 17) a vehicle can have; comparisons with NaN are false."""
    time, lat, lon, height = records[:, :4].T
    good = (time >= 0) & (time < 2 * _WEEK_S) & (np.abs(lat) <= np.pi / 2) & (np.abs(lon) <= np.pi)
    good &= np.abs(height) < _HIGHEST_M
    good &= (np.abs(records[:, 4:7]) < _FASTEST_M_S).all(1) & (np.abs(records[:, 7:9]) < _STEEPEST_RAD).all(1)
    return np.asarray(good & (np.abs(records[:, 9:11]) < _TURN_RAD).all(1))


def _lonely(time: np.ndarray) -> np.ndarray:
    """Return which times are far from both neighbours: a damaged one would put all later records in another week."""
    far = np.abs(np.diff(time)) > _NEAR_S
    far &= np.abs(np.abs(np.diff(time)) - _WEEK_S) > _NEAR_S
    alone = np.ones(len(time), bool)
    alone[1:] &= far
    alone[:-1] &= far
    return alone & (len(time) > 1)


def _week_start(time: np.ndarray, near_s: float) -> float:
    """Return the beginning of the week, s since 1970, that puts seconds of the week nearest to the time `near_s`."""
    week = np.floor((near_s - _GPS_EPOCH_S) / _WEEK_S)
    starts = _GPS_EPOCH_S + _WEEK_S * (week + np.array([0, -1, 1, -2]))
    before, behind = starts + time.min() - near_s, near_s - starts - time.max()
    return float(starts[np.argmin(np.maximum(np.maximum(before, behind), 0))])


def _leap_seconds(path: Path, utc_s: float) -> int:
    date = datetime.datetime.fromtimestamp(utc_s, datetime.UTC)
    year = date.year + (0.5 if date.month > 6 else 0.0)
    leaps = [leap for begin, leap in _LEAPS.items() if year >= begin]
    if not leaps:
        raise SbetError(f"{path}: the survey is of {date:%Y-%m-%d}, and leap seconds are known from 1999 on")
    return leaps[-1]
