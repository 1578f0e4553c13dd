"""The vehicle: its track, its attitude, and the drift of its dead reckoning."""

from dataclasses import dataclass

import numba
import numpy as np
from scipy import ndimage

from pointnetkl.simulation import sonar
from pointnetkl.simulation.seabed import Seabed
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

EPOCH_S = 1_600_000_000.0  # start of every simulated survey, so that no clock is read


class VehicleError(PointNetKLError):
    """A vehicle cannot run a survey as its settings ask."""


@dataclass(frozen=True)
class Attitude:
    """The vehicle's sway about its course, and the error of its attitude sensor."""

    roll_deg: float  # amplitude of the sway
    pitch_deg: float
    yaw_deg: float
    period_s: float
    error_deg: float  # standard deviation of measured roll and pitch
    wander_m: float  # amplitude of its excursions from the line


@dataclass(frozen=True)
class Navigation:
    """Errors of dead reckoning, which starts at the truth and is never corrected."""

    scale_error: float  # of the Doppler log; standard deviation of one draw a survey
    heading_error_deg: float  # standard deviation of one draw a survey, and again of a slow walk about it
    velocity_error_mps: float  # standard deviation of a slow walk, each axis
    correlation_s: float  # of both walks


@dataclass(frozen=True)
class Settings:
    """One kind of vehicle and its multibeam sonar."""

    speed_mps: float
    attitude: Attitude
    navigation: Navigation
    sonar: sonar.Settings

    def __post_init__(self) -> None:
        """Refuse a vehicle that does not move.

        Raises:
            ValueError: its speed is not positive.
        """
        parameters.require_positive(self, "speed_mps")


@dataclass(frozen=True)
class Layout:
    """A lawnmower pattern about the survey's centre."""

    lines: int
    line_length_m: float
    line_spacing_m: float
    start_jitter_m: float  # each line starts early or late by up to this much
    repeat_m: float  # length of a last line over the middle one; 0 for none
    azimuth_deg: float  # of the first line, counter-clockwise from east

    def __post_init__(self) -> None:
        """Refuse a survey without a line.

        Raises:
            ValueError: there is no line, or a length is not positive.
        """
        parameters.require_positive(self, "lines", "line_length_m", "line_spacing_m")


@dataclass(frozen=True)
class Track:
    """Poses at the pings, in projected coordinates; arrays (n,)."""

    line: np.ndarray
    time_s: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    yaw: np.ndarray
    roll: np.ndarray
    pitch: np.ndarray


def lines(layout: Layout, rng: np.random.Generator) -> np.ndarray:
    """Return the lines (k, 2, 2): start and end, each along and across the first line's course, metres."""
    across = (np.arange(layout.lines) - (layout.lines - 1) / 2) * layout.line_spacing_m
    start = -layout.line_length_m / 2 + rng.uniform(-1, 1, layout.lines) * layout.start_jitter_m
    ends = np.stack([start, start + layout.line_length_m], axis=1)
    ends[1::2] = ends[1::2, ::-1]  # back and forth
    track = np.stack([ends, np.repeat(across[:, None], 2, axis=1)], axis=2)
    if layout.repeat_m > 0:
        middle = across[layout.lines // 2]
        half = np.array([-0.5, 0.5]) * layout.repeat_m
        track = np.concatenate([track, np.stack([half, np.full(2, middle)], axis=1)[None]])
    return track


def sail(
    track: np.ndarray,
    azimuth_deg: float,
    ping_spacing_m: float,
    altitude_m: float,
    vehicle: Settings,
    seabed: Seabed,
    rng: np.random.Generator,
) -> Track:
    """Return the true poses at the pings of `lines`; turns take time but have no pings.

    Raises:
        VehicleError: the seabed is unknown under the track, or comes too near the surface to fly above it.
    """
    centre, azimuth = _centre(track, azimuth_deg, altitude_m, vehicle, seabed), np.deg2rad(azimuth_deg)
    along, across, course, line, distance = _waypoints(track, ping_spacing_m)
    time = distance / vehicle.speed_mps
    wander = vehicle.attitude.wander_m * np.sin(distance / 40.0)
    c, s = np.cos(azimuth), np.sin(azimuth)
    x, y = centre[0] + c * along - s * (across + wander), centre[1] + s * along + c * (across + wander)
    yaw, roll, pitch = (_sway(time, a, vehicle.attitude.period_s, rng) for a in _amplitudes(vehicle.attitude))
    z = _follow(seabed(x, y), line, altitude_m, ping_spacing_m)
    return Track(line, EPOCH_S + time, x, y, z, course + azimuth + yaw, roll, pitch)


def dead_reckoned(
    track: Track, navigation: Navigation, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x, y (n,) metres and yaw (n,) radians by dead reckoning, exact at the first ping."""
    step = np.diff(track.time_s, prepend=track.time_s[0])
    walk = np.stack([_walk(step, navigation.correlation_s, rng) for _ in range(3)])
    scale = 1.0 + navigation.scale_error * rng.normal()
    heading_error = np.deg2rad(navigation.heading_error_deg) * (rng.normal() + walk[2])
    dx, dy = np.diff(track.x, prepend=track.x[0]), np.diff(track.y, prepend=track.y[0])
    c, s = scale * np.cos(heading_error), scale * np.sin(heading_error)
    x = track.x[0] + np.cumsum(c * dx - s * dy + navigation.velocity_error_mps * walk[0] * step)
    y = track.y[0] + np.cumsum(s * dx + c * dy + navigation.velocity_error_mps * walk[1] * step)
    return x, y, track.yaw + heading_error


def _centre(
    track: np.ndarray, azimuth_deg: float, altitude_m: float, vehicle: Settings, seabed: Seabed
) -> tuple[float, float]:
    """Return the survey's centre, with room for the swath on both sides."""
    reach = 2 * altitude_m * np.tan(np.deg2rad(vehicle.sonar.sector_deg / 2))
    size = 2 * np.abs(track).max(axis=(0, 1)) + np.array([0.2 * reach, reach])
    return seabed.place(float(size[0]), float(size[1]), float(np.deg2rad(azimuth_deg)))


def _waypoints(track: np.ndarray, spacing_m: float) -> tuple[np.ndarray, ...]:
    """Return along, across, course, line and distance covered (n,) of every ping."""
    columns, covered, before = [], 0.0, track[0, 0]
    for number, (start, end) in enumerate(track):
        # from line to line a half circle, and the rest of the distance straight
        covered += float(np.abs(start - before) @ [1.0, np.pi / 2])
        length = float(np.linalg.norm(end - start))
        step = np.arange(0.0, length, spacing_m)
        point = start + step[:, None] * (end - start) / length
        course = np.full(len(step), np.arctan2(end[1] - start[1], end[0] - start[0]))
        columns.append((point[:, 0], point[:, 1], course, np.full(len(step), number), covered + step))
        covered, before = covered + length, end
    return tuple(np.concatenate(column) for column in zip(*columns, strict=True))


def _amplitudes(attitude: Attitude) -> np.ndarray:
    return np.deg2rad([attitude.yaw_deg, attitude.roll_deg, attitude.pitch_deg])


def _sway(time: np.ndarray, amplitude: float, period: float, rng: np.random.Generator) -> np.ndarray:
    """Return an angle (n,) that swings with three periods near `period`."""
    phases, periods = rng.uniform(0, 2 * np.pi, 3), period * rng.uniform(0.7, 1.6, 3)
    waves = np.sin(2 * np.pi * time[:, None] / periods + phases)
    return np.asarray(amplitude * waves @ [0.6, 0.3, 0.1])


def _follow(ground: np.ndarray, line: np.ndarray, altitude_m: float, spacing_m: float) -> np.ndarray:
    """Return the vehicle's z (n,), at its altitude above the ground, which is smoothed over about the altitude."""
    if not np.isfinite(ground).all():
        raise VehicleError("the seabed is unknown under a part of the track; shorten the lines")
    z = np.empty(len(ground))
    for number in np.unique(line):
        pings = line == number
        z[pings] = altitude_m + ndimage.gaussian_filter1d(ground[pings], altitude_m / spacing_m / 2, mode="nearest")
    if z.max() > 0:
        raise VehicleError(
            f"at {altitude_m:.0f} m above the ground the vehicle would fly {z.max():.0f} m above the surface;"
            " lower altitude_m or choose a deeper seabed"
        )
    return z


def _walk(step: np.ndarray, correlation: float, rng: np.random.Generator) -> np.ndarray:
    """Return a first-order Gauss-Markov process (n,) of unit variance at times `step` apart."""
    keep = np.exp(-step / correlation)
    return _filtered(keep, np.sqrt(1 - keep**2) * rng.normal(size=len(step)), float(rng.normal()))


@numba.njit(cache=True, nogil=True)
def _filtered(keep: np.ndarray, drive: np.ndarray, state: float) -> np.ndarray:
    out = np.empty(len(keep))
    for k in range(len(keep)):
        state = keep[k] * state + drive[k]
        out[k] = state
    return out
