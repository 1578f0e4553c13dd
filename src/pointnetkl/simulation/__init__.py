"""Simulated surveys: a vehicle with a sonar runs over a seabed and logs raw pings; the true trajectory is known."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.simulation import grid, seabed, sonar, vehicle
from pointnetkl.simulation.vehicle import Layout  # by name, because Settings has a field `vehicle`
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive, require_seed

_NAVIGATION = ("time_s", "x_m", "y_m", "depth_m", "roll_rad", "pitch_rad", "heading_rad")
_SOUNDING = ("along_m", "across_m", "down_m")
# The generic raw format, which users may write too: a row for each sounding, with the vehicle's navigation in each.
RAW = pa.schema(
    [(name, pa.float64()) for name in _NAVIGATION]
    + [(name, pa.float32()) for name in _SOUNDING]
    + [("beam", pa.int32()), ("quality", pa.int8())]
)
_RESOLUTION_M = 1 / 128  # of logged soundings, as in the datagrams of a sonar


class SimulationError(PointNetKLError):
    """A survey's parameters contradict each other."""


@dataclass(frozen=True)
class Settings:
    """One simulated survey."""

    seed: int
    vehicle: str  # name in section `vehicles`
    grid: str  # a GeoTIFF or BAG of depths, or data/none for a seabed drawn from the seed
    altitude_m: float
    ping_spacing_m: float
    beam_spacing_m: float
    layout: Layout
    grid_roughness_m: float = 0.0
    grid_sunk_m: float = 0.0  # added to the grid's depths, where they are too shallow for the vehicle
    centre_m: list[float] = field(default_factory=list)  # easting, northing; optional with a grid
    # both only without a grid
    crs: str = ""
    terrain: seabed.Settings | None = None

    def __post_init__(self) -> None:
        """Refuse lengths that are not positive.

        Raises:
            ValueError: a length is not positive, or the seed is negative.
        """
        require_positive(self, "altitude_m", "ping_spacing_m", "beam_spacing_m")
        require_seed(self.seed)


@dataclass(frozen=True)
class Line:
    """One line of a survey."""

    raw: pd.DataFrame  # schema RAW
    truth: pd.DataFrame  # schema survey.TRAJECTORY, in the raw coordinates


def ground(settings: Settings) -> seabed.Seabed:
    """Return a survey's seabed: its grid, or a random one if the grid is data/none.

    Raises:
        GridError: the grid cannot be read.
        SimulationError: the settings have neither a grid nor a random seabed.
    """
    path = Path(settings.grid)
    if not path.is_file():
        raise SimulationError(f"{path}: there is no such grid; write data/none for a random seabed")
    if not artifacts.is_none(path):
        centre = _centre(settings.centre_m) if settings.centre_m else None
        return grid.read(path, settings.grid_roughness_m, settings.seed, settings.grid_sunk_m, centre)
    if settings.terrain is None or not settings.crs:
        raise SimulationError("a survey without a grid needs `crs`, `centre_m: [easting, northing]` and `terrain`")
    return seabed.Random(settings.terrain, settings.seed, settings.crs, _centre(settings.centre_m))


def survey(settings: Settings, vehicle_settings: vehicle.Settings, terrain: seabed.Seabed) -> Iterator[Line]:
    """Yield a survey line by line: raw pings as the vehicle logs them, and its true trajectory."""
    rng = np.random.default_rng([settings.seed, 0])
    lines = vehicle.lines(settings.layout, rng)
    track = vehicle.sail(
        lines, settings.layout.azimuth_deg, settings.ping_spacing_m, settings.altitude_m, vehicle_settings, terrain, rng
    )
    navigation = np.stack(vehicle.dead_reckoned(track, vehicle_settings.navigation, rng), axis=1)
    angle = sonar.angles(settings.altitude_m, settings.beam_spacing_m, vehicle_settings.sonar)
    for number in range(len(lines)):
        pings = np.flatnonzero(track.line == number)
        # a random stream for each line, so that more lines leave the noise of the first ones as it is
        line_rng = np.random.default_rng([settings.seed, 1, number])
        yield _line(track, pings, navigation[pings], angle, settings.altitude_m, vehicle_settings, terrain, line_rng)


def patch(terrain: seabed.Settings, n_points: int, spacing_m: float, rng: np.random.Generator) -> np.ndarray:
    """Return a cloud (n_points, 3), metres, centred: a jittered grid 1.7 times as long as wide."""
    rows = max(1, round(np.sqrt(n_points / 1.7)))
    cell = np.arange(n_points)
    xy = np.stack([cell // rows, cell % rows], axis=1) + rng.uniform(0, 1, (n_points, 2))
    xy *= spacing_m
    origin = rng.uniform(-2e4, 2e4, 2)
    z = seabed.heights(terrain, int(rng.integers(1 << 20)), *(xy + origin).T)
    cloud = np.column_stack([xy, z])
    return cloud - cloud.mean(axis=0)


def _centre(values: list[float]) -> tuple[float, float]:
    if len(values) != 2:
        raise SimulationError(f"centre_m is {values}, must be [easting, northing]")
    return values[0], values[1]


def _line(
    track: vehicle.Track,
    pings: np.ndarray,
    navigation: np.ndarray,
    angle: np.ndarray,
    altitude_m: float,
    vehicle_settings: vehicle.Settings,
    terrain: seabed.Seabed,
    rng: np.random.Generator,
) -> Line:
    attitude = np.stack([track.roll[pings], track.pitch[pings]], axis=1)
    measured = attitude + np.deg2rad(vehicle_settings.attitude.error_deg) * rng.normal(size=attitude.shape)
    position = np.stack([track.x[pings], track.y[pings], track.z[pings]], axis=1)
    soundings = sonar.ping(
        terrain, position, track.yaw[pings], attitude, measured, angle, altitude_m, vehicle_settings.sonar, rng
    )
    truth = {"time_s": track.time_s[pings], "x_m": position[:, 0], "y_m": position[:, 1], "z_m": position[:, 2]}
    heading = np.mod(np.pi / 2 - navigation[:, 2], 2 * np.pi)  # compass: clockwise from north
    logged = (track.time_s[pings], *navigation[:, :2].T, -position[:, 2], *measured.T, heading)
    raw = {name: column[soundings.ping] for name, column in zip(_NAVIGATION, logged, strict=True)}
    for name, column in zip(_SOUNDING, (soundings.along, soundings.across, soundings.down), strict=True):
        raw[name] = np.round(column / _RESOLUTION_M) * _RESOLUTION_M
    raw |= {"beam": soundings.beam, "quality": soundings.quality.astype(np.int8)}
    yaw = np.angle(np.exp(1j * track.yaw[pings]))
    return Line(pd.DataFrame(raw), pd.DataFrame(truth | {"yaw_rad": yaw}))
