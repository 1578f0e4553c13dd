"""What is believed of navigation before any loop closure: its drift, and ties to places that are known."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.correction.result import CorrectionError
from pointnetkl.readers import projection
from pointnetkl.registration.pair import factor
from pointnetkl.slam.closing import drift, gates, solving
from pointnetkl.slam.closing.estimate import Closure, Estimate, Tie
from pointnetkl.surveys.se2 import rotate

_LARGEST = 400.0  # factor on the variance of drift, that ties can ask for
_HELD_M = 0.01  # standard deviation of what is held
_PLANE, _EARTH = ("x_m", "y_m"), ("lon_deg", "lat_deg")


@dataclass(frozen=True)
class Navigation:
    """Navigation of n submaps in the order of the track, and how it drifts."""

    time_s: np.ndarray  # (n,)
    poses: np.ndarray  # (n, 3) x, y, yaw
    rates: drift.Settings
    fix: drift.Fix | None  # where dead reckoning begins; None where positions are absolute
    exact: bool = False  # absolute by a satellite receiver: what is said of their sigma is to be believed

    def covariance(self, rates: drift.Settings | None = None) -> np.ndarray:
        """Return the covariance (3 n, 3 n) of the poses, by these rates or others."""
        return drift.covariance(self.time_s, self.poses[:, :2], rates or self.rates, self.fix)


def trusted(navigation: Navigation, anchors: Sequence[Closure], settings: factor.Settings) -> list[Closure]:
    """Return the ties that agree with navigation and each other (gates.by_prediction).

    Drift counts for as large as most of them say, so that many right ones outweigh it.
    """
    estimate = Estimate(navigation.poses, navigation.covariance())
    larger = np.clip(solving.variance_factor(estimate, anchors), 1.0, _LARGEST) if anchors else 1.0
    agreed = gates.by_prediction(Estimate(estimate.poses, larger * estimate.covariance), anchors, settings)
    return [anchor for anchor, good in zip(anchors, agreed.tolist(), strict=True) if good]


def held(files: Collection[str], pings: pd.DataFrame, navigation: Navigation) -> list[Closure]:
    """Return ties that hold the submaps of some raw files where navigation has them.

    Raises:
        CorrectionError: one of the files is not of the survey.
    """
    known = sorted(set(pings["file"]))
    if missing := sorted(set(files) - set(known)):
        raise CorrectionError(f"{missing[0]}: is to be held, and is no file of this survey; it has {_listed(known)}")
    rows = np.searchsorted(pings["time_s"].to_numpy(), navigation.time_s).clip(max=len(pings) - 1)
    of_file = pings["file"].to_numpy()[rows]
    return [
        _tie(navigation, int(k), np.zeros(2), np.zeros(2), _HELD_M) for k in np.flatnonzero(np.isin(of_file, [*files]))
    ]


def fixes(
    path: Path, crs: str, origin: tuple[float, float], pings: pd.DataFrame, navigation: Navigation
) -> list[Closure]:
    """Return ties of submaps to absolute fixes of position: USBL, or marks at the surface.

    The CSV has columns time_s (UTC since 1970), sigma_m, and lon_deg, lat_deg or x_m, y_m (easting, northing in the
    survey's CRS). A fix holds the submap nearest in time, by the vehicle's place at that time.

    Raises:
        CorrectionError: the file cannot be read, lacks a column, or no fix is of the survey's time.
    """
    table = read_fixes(path)
    places = _places(path, table, crs) - np.array(origin)
    time, sigma = table["time_s"].to_numpy(np.float64), table["sigma_m"].to_numpy(np.float64)
    at = pings["time_s"].to_numpy()
    inside = (time >= at[0]) & (time <= at[-1]) & np.isfinite(places).all(axis=1) & (sigma > 0) & np.isfinite(sigma)
    if not inside.any():
        raise CorrectionError(
            f"{path}: none of its {len(table)} fixes is of the survey's time, {at[0]:.0f} to {at[-1]:.0f} s, with a"
            " sigma_m above 0"
        )
    ties = []
    for t, place, s in zip(time[inside], places[inside], sigma[inside], strict=True):
        k = int(np.abs(navigation.time_s - t).argmin())
        there = np.array([np.interp(t, at, pings[axis].to_numpy()) for axis in _PLANE])
        ties.append(_tie(navigation, k, there - navigation.poses[k, :2], place - there, float(s)))
    return ties


def _tie(navigation: Navigation, k: int, arm: np.ndarray, offset: np.ndarray, sigma_m: float) -> Closure:
    """Return the tie that moves a point, `arm` (2,) from submap k in axes of the map, by an offset (2,)."""
    poses, precision = navigation.poses, np.eye(2) / sigma_m
    lever = rotate(arm, -float(poses[k, 2]))
    tie = Tie.at(poses, int(k), [], np.empty(0), lever)
    return Closure(tie, precision, precision @ offset, sigma_m**2, offset)


def read_fixes(path: Path) -> pd.DataFrame:
    """Return a table of fixes with its columns in lower case.

    Raises:
        CorrectionError: it cannot be read, or lacks a column.
    """
    try:
        table = pd.read_csv(path, skipinitialspace=True)
    except (OSError, ValueError) as error:
        raise CorrectionError(f"{path}: is no table of fixes ({' '.join(str(error).split())[:120]})") from error
    table = table.rename(columns=lambda name: str(name).strip().lower())
    if missing := [name for name in ("time_s", "sigma_m") if name not in table]:
        raise CorrectionError(
            f"{path}: lacks the column {missing[0]}; fixes have time_s, sigma_m and lon_deg, lat_deg or x_m, y_m"
        )
    if table.empty:
        raise CorrectionError(f"{path}: has no fix below its line of names")
    numbers = table.select_dtypes("number").columns
    if words := [name for name in table if name in ("time_s", "sigma_m", *_PLANE, *_EARTH) and name not in numbers]:
        raise CorrectionError(f"{path}: column {words[0]} holds a word, must hold numbers")
    return table


def _places(path: Path, table: pd.DataFrame, crs: str) -> np.ndarray:
    if set(_PLANE) <= set(table):
        return table[[*_PLANE]].to_numpy(np.float64)
    if not set(_EARTH) <= set(table):
        raise CorrectionError(f"{path}: lacks columns of a place; fixes have lon_deg, lat_deg or x_m, y_m")
    if crs == projection.LOCAL:
        raise CorrectionError(f"{path}: fixes are on the earth, and the survey is not; give them as x_m, y_m")
    longitude, latitude = (table[name].to_numpy(np.float64) for name in _EARTH)
    possible, places = (np.abs(longitude) <= 180) & (np.abs(latitude) <= 90), np.full((len(table), 2), np.nan)
    try:
        frame = projection.frame(projection.GEOGRAPHIC, crs, longitude[possible], latitude[possible])
    except projection.ProjectionError as error:
        raise CorrectionError(f"{path}: has fixes that are nowhere near the survey's map, {crs}") from error
    places[possible] = np.column_stack([frame.x, frame.y])
    return places


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
