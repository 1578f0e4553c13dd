"""Longitude and latitude to a map in metres, with the map's rotation and scale at each place."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl.surveys.survey import SurveyError

GEOGRAPHIC = "EPSG:4326"  # positions are longitude and latitude on WGS84, in degrees
LOCAL = "local"  # metres east and north of an unknown place
AUTO = "auto"  # the UTM zone of the first position

_A_M, _E2 = 6_378_137.0, 0.00669437999014  # WGS84: semi-major axis, eccentricity squared
_STEP_M = 10.0  # for differences: small against the earth, large against rounding


class ProjectionError(SurveyError):
    """A coordinate system is unknown, or is not a map in metres."""


@dataclass(frozen=True)
class Frame:
    """Places of n pings in a projected CRS, and the rotation and scale of the map there.

    On a conformal map a straight line on the ground stays straight to some 1e-5 of its length over a swath. To neglect
    the rotation (meridian convergence) would cost metres at the edge of a UTM zone.
    """

    crs: str
    x: np.ndarray  # (n,) easting, metres
    y: np.ndarray  # (n,) northing, metres
    tangent: np.ndarray  # (n, 2, 2) map metres per metre on the ground, columns east and north

    def turned(self, row: np.ndarray | slice, east: np.ndarray, north: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return offsets on the map; `east`, `north` are offsets on the ground, metres from the pings in `row`."""
        tangent = self.tangent[row]
        return tangent[:, 0, 0] * east + tangent[:, 0, 1] * north, tangent[:, 1, 0] * east + tangent[:, 1, 1] * north


def frame(crs: str, zone: str, east: np.ndarray, north: np.ndarray) -> Frame:
    """Return positions (n,) as a frame: longitudes and latitudes are projected to `zone`, others stay as they are.

    Raises:
        ProjectionError: the zone is not a projected CRS in metres, or does not reach all positions.
    """
    if crs != GEOGRAPHIC:
        return Frame(crs, east, north, np.broadcast_to(np.eye(2), (len(east), 2, 2)))
    from pyproj import Transformer  # slow to import, and projected surveys do not need it

    target = utm(float(east[0]), float(north[0])) if zone == AUTO else _metric(zone)
    to_map = Transformer.from_crs(GEOGRAPHIC, target, always_xy=True)
    per_east, per_north = _degrees_per_metre(north)
    x, y = to_map.transform(east, north)
    x_east, y_east = to_map.transform(east + _STEP_M * per_east, north)
    x_north, y_north = to_map.transform(east, north + _STEP_M * per_north)
    with np.errstate(invalid="ignore"):  # places that the zone does not reach are infinite
        tangent = np.stack([x_east - x, x_north - x, y_east - y, y_north - y], 1).reshape(-1, 2, 2) / _STEP_M
    if lost := int(np.sum(~np.isfinite(tangent.sum((1, 2)) + x + y))):
        raise ProjectionError(
            f"{lost} of {len(x)} positions lie outside {target}, the first position is at longitude {east[0]:.3f},"
            f" latitude {north[0]:.3f}; set ingest.utm_zone"
        )
    return Frame(target, x, y, tangent)


def beside(path: Path) -> str:
    """Return the CRS named in a file with the raw file's name and the extension .crs; LOCAL without such a file.

    Raises:
        ProjectionError: the file names no CRS, or cannot be read.
    """
    named = path.with_suffix(".crs")
    if not named.is_file():
        return LOCAL
    try:
        crs = named.read_text(errors="replace").strip()
    except OSError as error:
        raise ProjectionError(f"{named}: cannot be read ({error.strerror})") from error
    if not crs or "\0" in crs:
        raise ProjectionError(f"{named}: must name a coordinate system, such as EPSG:32633")
    return crs


def utm(longitude: float, latitude: float) -> str:
    """Return the EPSG code of the UTM zone (WGS84) of a position in degrees."""
    number = min(int((longitude + 180.0) // 6.0), 59) + 1
    return f"EPSG:{(32600 if latitude >= 0 else 32700) + number}"


def roughly(longitude: np.ndarray, latitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return metres east and north of the first position, good enough to find jumps in a track."""
    per_east, per_north = _degrees_per_metre(latitude)
    turn = np.mod(longitude - longitude[0] + 180.0, 360.0) - 180.0  # a track may cross the date line
    return turn / per_east, (latitude - latitude[0]) / per_north


def _degrees_per_metre(latitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return degrees of longitude per metre east and of latitude per metre north, on the ellipsoid."""
    phi = np.deg2rad(latitude)
    w = np.sqrt(1.0 - _E2 * np.sin(phi) ** 2)
    normal, meridian = _A_M / w, _A_M * (1.0 - _E2) / w**3
    return np.rad2deg(1.0 / (normal * np.maximum(np.cos(phi), 1e-6))), np.rad2deg(1.0 / meridian)


def _metric(zone: str) -> str:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        crs = CRS.from_user_input(zone)
    except CRSError as error:
        raise ProjectionError(f"ingest.utm_zone is {zone!r}, must be auto or a code such as EPSG:32633") from error
    if not crs.is_projected or any(axis.unit_name != "metre" for axis in crs.axis_info):
        raise ProjectionError(f"ingest.utm_zone {zone} ({crs.name}) is not a map in metres; take a UTM zone")
    return zone
