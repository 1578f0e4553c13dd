"""Surveys that nobody had to sail: a seabed, a vehicle and its sonar make raw pings, and the truth is known."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.simulation import grid, seabed, sonar, vehicle
from pointnetkl.simulation.vehicle import Layout  # `vehicle` is also the name of a setting
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive, require_seed

_NAVIGATION = ("time_s", "x_m", "y_m", "depth_m", "roll_rad", "pitch_rad", "heading_rad")
_SOUNDING = ("along_m", "across_m", "down_m")
# The generic raw format that a user may bring too: a row a sounding, the vehicle's navigation repeated in each.
RAW = pa.schema(
    [(name, pa.float64()) for name in _NAVIGATION]
    + [(name, pa.float32()) for name in _SOUNDING]
    + [("beam", pa.int32()), ("quality", pa.int8())]
)
_RESOLUTION_M = 1 / 128  # of logged soundings, as in a sonar's datagrams


class SimulationError(PointNetKLError):
    """A survey's parameters contradict each other."""


@dataclass(frozen=True)
class Settings:
    """One simulated survey."""

    seed: int
    vehicle: str  # of section `vehicles`
    grid: str  # a GeoTIFF or BAG of depths, or data/none for a seabed drawn from the seed
    altitude_m: float
    ping_spacing_m: float
    beam_spacing_m: float
    layout: Layout
    grid_roughness_m: float = 0.0
    grid_sunk_m: float = 0.0  # how much deeper the ground lies than in the grid, where that is too shallow to sail
    centre_m: list[float] = field(default_factory=list)  # easting, northing; a grid has a middle, and may have another
    # of a drawn seabed; a grid brings its own
    crs: str = ""
    terrain: seabed.Settings | None = None

    def __post_init__(self) -> None:
        """Refuse lengths that are none.

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
    """Return the seabed that a survey runs over: its grid, or a random one where the grid is data/none.

    Raises:
        GridError: the grid cannot be read.
        SimulationError: there is neither a grid nor a seabed.
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


def survey(settings: Settings, craft: vehicle.Settings, terrain: seabed.Seabed) -> Iterator[Line]:
    """Sail a survey, line by line: raw pings as the vehicle logs them, and its true trajectory."""
    rng = np.random.default_rng([settings.seed, 0])
    lines = vehicle.lines(settings.layout, rng)
    track = vehicle.sail(
        lines, settings.layout.azimuth_deg, settings.ping_spacing_m, settings.altitude_m, craft, terrain, rng
    )
    navigation = np.stack(vehicle.dead_reckoned(track, craft.navigation, rng), axis=1)
    angle = sonar.angles(settings.altitude_m, settings.beam_spacing_m, craft.sonar)
    for number in range(len(lines)):
        on = np.flatnonzero(track.line == number)
        # a stream of its own for every line: a longer survey leaves its first lines' noise as it was
        line_rng = np.random.default_rng([settings.seed, 1, number])
        yield _line(track, on, navigation[on], angle, settings.altitude_m, craft, terrain, line_rng)


def patch(terrain: seabed.Settings, n_points: int, spacing_m: float, rng: np.random.Generator) -> np.ndarray:
    """Return a cloud (n_points, 3), metres, centred: a jittered grid 1.7 times as long as wide."""
    rows = max(1, round(np.sqrt(n_points / 1.7)))
    cell = np.arange(n_points)
    xy = np.stack([cell // rows, cell % rows], axis=1) + rng.uniform(0, 1, (n_points, 2))
    xy *= spacing_m
    place = rng.uniform(-2e4, 2e4, 2)
    z = seabed.heights(terrain, int(rng.integers(1 << 20)), *(xy + place).T)
    cloud = np.column_stack([xy, z])
    return cloud - cloud.mean(axis=0)


def _centre(values: list[float]) -> tuple[float, float]:
    if len(values) != 2:
        raise SimulationError(f"centre_m is {values}, must be [easting, northing]")
    return values[0], values[1]


def _line(
    track: vehicle.Track,
    on: np.ndarray,
    navigation: np.ndarray,
    angle: np.ndarray,
    altitude_m: float,
    craft: vehicle.Settings,
    terrain: seabed.Seabed,
    rng: np.random.Generator,
) -> Line:
    attitude = np.stack([track.roll[on], track.pitch[on]], axis=1)
    measured = attitude + np.deg2rad(craft.attitude.error_deg) * rng.normal(size=attitude.shape)
    position = np.stack([track.x[on], track.y[on], track.z[on]], axis=1)
    heard = sonar.ping(terrain, position, track.yaw[on], attitude, measured, angle, altitude_m, craft.sonar, rng)
    truth = {"time_s": track.time_s[on], "x_m": position[:, 0], "y_m": position[:, 1], "z_m": position[:, 2]}
    heading = np.mod(np.pi / 2 - navigation[:, 2], 2 * np.pi)  # compass: clockwise from north
    logged = (track.time_s[on], *navigation[:, :2].T, -position[:, 2], *measured.T, heading)
    raw = {name: column[heard.ping] for name, column in zip(_NAVIGATION, logged, strict=True)}
    for name, column in zip(_SOUNDING, (heard.along, heard.across, heard.down), strict=True):
        raw[name] = np.round(column / _RESOLUTION_M) * _RESOLUTION_M
    raw |= {"beam": heard.beam, "quality": heard.quality.astype(np.int8)}
    yaw = np.angle(np.exp(1j * track.yaw[on]))
    return Line(pd.DataFrame(raw), pd.DataFrame(truth | {"yaw_rad": yaw}))
