"""The corrected track as arrays, and its place on the earth: what every product is written from."""

import functools
from dataclasses import dataclass

import numpy as np

from pointnetkl.correction.result import Corrected, CorrectionError
from pointnetkl.readers import projection
from pointnetkl.surveys.survey import SUBMAPS

GAP_S = 60.0  # between pings of one line; longer ones part two lines
_AFTER = ["moved_x_m", "moved_y_m", "moved_yaw_rad"]


@dataclass(frozen=True)
class Earth:
    """Places of a map on WGS84, and the map's rotation and scale there."""

    longitude_deg: np.ndarray  # (n,)
    latitude_deg: np.ndarray  # (n,)
    tangent: np.ndarray  # (n, 2, 2) map metres per metre on the ground, columns east and north

    @property
    def to_ground(self) -> np.ndarray:
        """Return the matrices (n, 2, 2) that take vectors of the map to east and north on the ground."""
        return np.linalg.inv(self.tangent)


class Placed:
    """A corrected track: the map frame's x and y, and with its origin eastings and northings."""

    def __init__(self, corrected: Corrected) -> None:
        """Take the track of a correction."""
        self.track = corrected.track
        self.crs = corrected.crs
        self.origin = np.array(corrected.origin)
        self.has_times = corrected.kind != SUBMAPS  # else they only count
        self.time_s = self.column("time_s")
        moved = self.track[_AFTER].to_numpy(np.float64)
        self.before = self.track[["x_m", "y_m", "yaw_rad"]].to_numpy(np.float64)
        self.after = self.before + moved  # (n, 3) x, y, yaw in the map frame
        self.z_m = self.column("z_m")

    def column(self, name: str) -> np.ndarray:
        """Return a column of the track; NaN where it has nothing."""
        return self.track[name].to_numpy(np.float64)

    @property
    def place(self) -> np.ndarray:
        """Return corrected eastings and northings (n, 2), metres."""
        return np.asarray(self.after[:, :2] + self.origin)

    @functools.cached_property
    def files(self) -> np.ndarray:
        """Return the raw file (n,) of each ping as text; empty where there is none."""
        return np.asarray(self.track["file"].fillna("").to_numpy(object))

    @functools.cached_property
    def earth(self) -> Earth | None:
        """Return the corrected places on the earth; None without a CRS.

        Raises:
            CorrectionError: the CRS is unknown or does not reach all places.
        """
        return on_earth(self.crs, self.place)

    @functools.cached_property
    def heading_rad(self) -> np.ndarray:
        """Return compass headings (n,) in [0, 2 pi): from true north, or without a CRS from the map's north."""
        ahead = np.column_stack([np.cos(self.after[:, 2]), np.sin(self.after[:, 2])])
        if self.earth is not None:
            ahead = np.einsum("nij,nj->ni", self.earth.to_ground, ahead)
        heading = np.mod(np.arctan2(ahead[:, 0], ahead[:, 1]), 2 * np.pi)
        return np.where(heading == 2 * np.pi, 0.0, heading)  # what is just below 0 rounds to a whole turn

    def covariance(self, prefix: str = "") -> np.ndarray:
        """Return the covariances (n, 2, 2) of places, m^2 in the axes of the map; with prefix `before_` before."""
        names = [f"{prefix}var_{axes}_m2" for axes in ("xx", "xy", "xy", "yy")]
        return np.asarray(self.track[names].to_numpy(np.float64).reshape(-1, 2, 2))

    @functools.cached_property
    def moments(self) -> np.ndarray:
        """Return the row of the first ping at each time; heads of one sonar ping at equal times."""
        return np.flatnonzero(np.diff(self.time_s, prepend=-np.inf) > 0)

    @functools.cached_property
    def lines(self) -> np.ndarray:
        """Return the line (n,) of each ping, from 0: a new one begins in each file and after gaps of a minute."""
        new = (self.files[1:] != self.files[:-1]) | (np.diff(self.time_s) > GAP_S)
        return np.cumsum(np.append(False, new)) if len(self.time_s) else np.zeros(0, int)

    @functools.cached_property
    def velocity(self) -> np.ndarray:
        """Return the velocities (n, 3) of `moments`: east, north (on the ground) and up, m/s; NaN of a single one.

        They are differences of the corrected track, of both sides where both belong to one line.
        """
        rows = self.moments
        places = np.column_stack([self.after[rows, :2], self.z_m[rows]])
        velocity = _slopes(self.time_s[rows], places)
        if self.earth is not None:
            velocity[:, :2] = np.einsum("nij,nj->ni", self.earth.to_ground[rows], velocity[:, :2])
        return velocity


def on_earth(crs: str, places: np.ndarray) -> Earth | None:
    """Return where eastings and northings (n, 2) of a projected CRS lie; None if the CRS is local.

    Raises:
        CorrectionError: the CRS is unknown or does not reach all places.
    """
    if crs == projection.LOCAL:
        return None
    from pyproj import Transformer  # slow to import
    from pyproj.exceptions import ProjError

    try:
        to_earth = Transformer.from_crs(crs, projection.GEOGRAPHIC, always_xy=True)
        longitude, latitude = (np.asarray(part) for part in to_earth.transform(*places.T))
        if not len(places):
            return Earth(longitude, latitude, np.zeros((0, 2, 2)))
        frame = projection.frame(projection.GEOGRAPHIC, crs, longitude, latitude)
    except (ProjError, projection.ProjectionError) as error:
        raise CorrectionError(f"the corrected track cannot be placed on the earth by {crs} ({error})") from error
    return Earth(longitude, latitude, frame.tangent)


def utc(time_s: np.ndarray) -> np.ndarray:
    """Return times (n,), seconds since 1970, in whole microseconds; NaT where there is none."""
    micro = np.round(time_s * 1e6)
    return np.where(np.isfinite(micro), np.nan_to_num(micro), np.iinfo(np.int64).min).astype("int64").view("M8[us]")


def iso(time_s: np.ndarray) -> list[str | None]:
    """Return times (n,) as ISO 8601 with microseconds and Z; None where there is none."""
    times = utc(time_s)
    text = np.datetime_as_string(times, unit="us").tolist()
    return [None if nothing else f"{time}Z" for time, nothing in zip(text, np.isnat(times).tolist(), strict=True)]


def _slopes(time_s: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return slopes (n, k) of places (n, k): over both neighbours, but over a gap only where nothing else is."""
    if len(time_s) < 2:
        return np.full(places.shape, np.nan)
    step, moved = np.diff(time_s)[:, None], np.diff(places, axis=0)
    near = step <= GAP_S
    weight = np.pad(np.where(near, step, 0.0), ((1, 1), (0, 0)))
    run = np.pad(np.where(near, moved, 0.0), ((1, 1), (0, 0)))
    total, sums = weight[:-1] + weight[1:], run[:-1] + run[1:]
    slope = np.vstack([moved / step, (moved / step)[-1:]])  # of a ping with gaps on both sides
    return np.divide(sums, total, out=slope, where=total > 0)
