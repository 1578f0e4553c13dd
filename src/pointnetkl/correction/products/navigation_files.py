"""The corrected navigation as SBET with SMRMSG, which surveying programs read in place of a sonar's own."""

from pathlib import Path

import numpy as np

from pointnetkl.correction.products.placed import Placed
from pointnetkl.readers import sbet
from pointnetkl.workflow import artifacts

_ARC_MINUTES = 60 * 180 / np.pi  # a radian
_UNKNOWN = np.nan


def write(sbet_path: Path, smrmsg_path: Path, track: Placed) -> list[str]:
    """Write both files, or neither; return why not. Pings at equal times count once.

    Raises:
        CorrectionError: the track cannot be placed on the earth.
        ArtifactError: a file cannot be written.
    """
    if reason := why_not(track):
        return [f"no SBET and no SMRMSG: {reason}"]
    try:
        time = _week_seconds(sbet_path, track.time_s[track.moments])
    except sbet.SbetError as error:  # before leap seconds are known
        return [f"no SBET and no SMRMSG: {error}"]
    artifacts.write_bytes(sbet_path, sbet_records(track, time).astype("<f8").tobytes())
    artifacts.write_bytes(smrmsg_path, smrmsg_records(track, time).astype("<f8").tobytes())
    return []


def why_not(track: Placed) -> str:
    """Return why a track cannot be SBET; nothing if it can."""
    if track.earth is None:
        return "the survey has no place on the earth"
    if not (track.has_times and np.isfinite(track.time_s).all()):
        return "the survey has no times"
    if not all(np.isfinite(track.column(name)).all() for name in ("roll_rad", "pitch_rad")):
        return "not all pings have roll and pitch"
    if len(track.moments) < 2:
        return "the survey has pings at one time only, which gives no speed"
    if (span := track.time_s[-1] - track.time_s[0]) >= sbet._WEEK_S:
        return f"the survey lasts {span / 86_400:.1f} days, and SBET has seconds of one week"
    return ""


def sbet_records(track: Placed, time: np.ndarray) -> np.ndarray:
    """Return the 17 numbers (n, 17) of each time; accelerations and angular rates are NaN."""
    rows, earth = track.moments, track.earth
    assert earth is not None
    east, north, up = track.velocity.T
    records = np.full((len(rows), 17), _UNKNOWN)
    records[:, 0] = time
    records[:, 1], records[:, 2] = np.deg2rad(earth.latitude_deg[rows]), np.deg2rad(earth.longitude_deg[rows])
    records[:, 3] = track.z_m[rows]
    records[:, 4], records[:, 5], records[:, 6] = north, east, -up
    records[:, 7], records[:, 8] = track.column("roll_rad")[rows], track.column("pitch_rad")[rows]
    records[:, 9], records[:, 10] = track.heading_rad[rows], 0.0  # no wander: the platform heading is the true one
    return records


def smrmsg_records(track: Placed, time: np.ndarray) -> np.ndarray:
    """Return the 10 numbers (n, 10) of each time; those of height, velocities, roll and pitch are NaN."""
    rows, earth = track.moments, track.earth
    assert earth is not None
    to_ground = earth.to_ground[rows]
    ground = to_ground @ track.covariance()[rows] @ np.swapaxes(to_ground, 1, 2)
    records = np.full((len(rows), 10), _UNKNOWN)
    records[:, 0] = time
    records[:, 1], records[:, 2] = np.sqrt(ground[:, 1, 1]), np.sqrt(ground[:, 0, 0])
    records[:, 9] = np.sqrt(track.column("var_yaw_rad2")[rows]) * _ARC_MINUTES
    return records


def _week_seconds(path: Path, time_s: np.ndarray) -> np.ndarray:
    """Return GPS seconds of the week in which the first time lies; after its end they go on above a week's."""
    # by the same leap seconds as the reader, which takes those of a survey's middle
    gps = time_s + sbet._leap_seconds(path, (time_s[0] + time_s[-1]) / 2) - sbet._GPS_EPOCH_S
    return np.asarray(gps - np.floor(gps[0] / sbet._WEEK_S) * sbet._WEEK_S)
