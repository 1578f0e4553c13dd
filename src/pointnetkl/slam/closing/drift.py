"""The drift of dead reckoning, from a vehicle's rates: the joint covariance of all poses, "Drift" in docs/closures.md.

A scale error and a heading bias are constant over a survey, and heading and velocity walk slowly. So the errors of
edges are not independent: a graph of edges with white noise is too sure of its poses. Here every pose's x, y (metres,
axes of the map) and yaw (radians) have one dense covariance (3 n, 3 n), in the order x, y, yaw of each.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pointnetkl.slam.graph.pose_graph import DeadReckoningNoise
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_within


class DriftError(PointNetKLError):
    """Times and places of poses do not make a track."""


@dataclass(frozen=True)
class Settings:
    """Standard deviations of a vehicle's navigation, while nothing but a Doppler log and its gyros aid it.

    A walk is a first-order Gauss-Markov process: of this standard deviation at any time, and of a correlation that
    falls to 1/e in the correlation time. Velocity walks in the axes of the map.

    Raises:
        ValueError: a setting is out of its range.
    """

    scale_error: float  # of the Doppler log, a share of the distance; constant over a survey
    heading_bias_rad: float  # constant over a survey
    heading_walk_rad: float
    heading_correlation_s: float
    velocity_walk_mps: float  # each axis
    velocity_correlation_s: float
    # of an absolute position, x and y, as a satellite receiver or USBL gives it: it wanders and is bounded
    position_walk_m: float = 0.0
    position_correlation_s: float = 600.0
    start_m: float = 0.0  # of the place where dead reckoning begins, which all poses share
    position_noise_m: float = 0.01  # of each pose alone, x and y
    yaw_noise_rad: float = 1e-5
    depth_noise_m: float = 0.05
    roll_noise_rad: float = 1e-4
    pitch_noise_rad: float = 1e-4

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        correlations = [field.name for field in dataclasses.fields(self) if "_correlation_" in field.name]
        require_within(self, 1e-3, 1e9, *correlations)
        require_within(self, 0.0, 1.0, "scale_error", "heading_bias_rad", "heading_walk_rad")
        require_within(self, 0.0, 10.0, "velocity_walk_mps")
        require_within(self, 0.0, 1e4, "position_walk_m", "start_m")
        noises = [field.name for field in dataclasses.fields(self) if "_noise_" in field.name]
        require_within(self, 1e-9, 1e3, *noises)  # above 0: the covariance of all poses must have an inverse

    def times(self, factor: float) -> "Settings":
        """Return these settings with every standard deviation multiplied by a factor."""
        sigmas = {name: factor * value for name, value in vars(self).items() if "correlation" not in name}
        return dataclasses.replace(self, **sigmas)


# By grade of the inertial unit, with a Doppler log. What a data sheet states is an accuracy over all time; half of its
# variance is taken for constant and half for a walk. Sources: docs/closures.md.
PRESETS: Mapping[str, Settings] = MappingProxyType(
    {
        # ring laser or fibre optic gyros of navigation grade (0.003 deg/h), a calibrated log: 0.1 to 0.2 % of distance
        "navigation_grade": Settings(1e-3, 3.5e-4, 3.5e-4, 1800.0, 2e-3, 300.0),
        # fibre optic gyrocompass (0.1 deg): 0.3 % of distance
        "gyrocompass": Settings(2e-3, 1.2e-3, 1.2e-3, 1200.0, 4e-3, 300.0, yaw_noise_rad=1e-4),
        # micromechanical unit with a magnetic compass (0.5 to 1 deg): 1 to 2 % of distance
        "compass": Settings(4e-3, 1e-2, 1e-2, 600.0, 1e-2, 300.0, yaw_noise_rad=1e-3),
        # positions of a satellite receiver, which do not drift; heading of its two antennas or of a gyrocompass
        "gnss": Settings(0.0, 0.0, 0.0, 1200.0, 0.0, 300.0, 0.5, 600.0, position_noise_m=0.02, yaw_noise_rad=2e-3),
        # a vehicle whose unit is aided by USBL from a ship; heading of its gyrocompass
        "usbl": Settings(0.0, 0.0, 0.0, 1200.0, 0.0, 300.0, 3.0, 300.0, position_noise_m=0.1, yaw_noise_rad=2e-3),
    }
)


def named(name: str, stated: Mapping[str, Settings], where: str = "navigation") -> Settings:
    """Return the rates of that name, of those stated or of PRESETS; `where` the name stands is for the error.

    Raises:
        DriftError: there are none.
    """
    known = {**PRESETS, **stated}
    if name not in known:
        names = ", ".join(known)
        raise DriftError(f"{where} is {name!r}, must be one of {names}; or state such rates in section navigation")
    return known[name]


@dataclass(frozen=True)
class Fix:
    """Where and when navigation was last known: from there on it drifts."""

    time_s: float
    x_m: float
    y_m: float


def covariance(time_s: np.ndarray, xy: np.ndarray, settings: Settings, fix: Fix | None = None) -> np.ndarray:
    """Return the covariance (3 n, 3 n) of dead reckoning's poses, m^2 and rad^2: x, y, yaw of each.

    Args:
        time_s: (n,) of the poses, which must grow.
        xy: (n, 2) metres, by navigation.
        settings: the vehicle's rates.
        fix: where the position was exact, before the first pose; None: at the first pose.

    Raises:
        DriftError: times do not grow, or there are not as many of them as places.
    """
    times, places = _track(time_s, xy, fix)
    n = len(times)
    total = np.zeros((n, 3, n, 3))
    for i, j, part in _parts(times, places, settings):
        total[:, i, :, j] += part
    kept = total[n - len(time_s) :, :, n - len(time_s) :].reshape(2 * (3 * len(time_s),))
    return np.asarray((kept + kept.T) / 2 + np.diag(np.tile(_noise(settings), len(time_s))))


def relations(
    time_s: np.ndarray, xy: np.ndarray, settings: Settings, rows: np.ndarray, fix: Fix | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return what `covariance` has of some poses (m,) with all: (3 m, 3 n), and of each pose with itself (n, 3, 3).

    It is for many poses of which few are tied: the covariance of all would not fit in memory.

    Raises:
        DriftError: as by covariance.
    """
    times, places = _track(time_s, xy, fix)
    before, n = len(times) - len(time_s), len(time_s)
    cross, own = np.zeros((len(rows), 3, n, 3)), np.zeros((n, 3, 3))
    for i, j, part in _parts(times, places, settings):
        cross[:, i, :, j] += part[rows + before, before:]
        own[:, i, j] += np.diagonal(part)[before:]
    noise = np.diag(_noise(settings))
    cross[np.arange(len(rows)), :, rows] += noise
    return cross.reshape(3 * len(rows), 3 * n), own + noise


def _noise(settings: Settings) -> np.ndarray:
    return np.square([settings.position_noise_m, settings.position_noise_m, settings.yaw_noise_rad])


def _parts(times: np.ndarray, places: np.ndarray, settings: Settings) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield pairs of axes (0: x, 1: y, 2: yaw), and a part (n, n) of the covariance of one with the other."""
    step, move = np.diff(times), np.diff(places, axis=0)
    crosswise = np.column_stack([-move[:, 1], move[:, 0]])  # where a heading error takes a move
    for source, sigma, yaw in ((move, settings.scale_error, 0.0), (crosswise, settings.heading_bias_rad, 1.0)):
        effect = sigma * np.column_stack([_summed(source), np.full(len(times), yaw)])
        yield from ((i, j, np.outer(effect[:, i], effect[:, j])) for i in range(3) for j in range(3))
    for i, j, part in _of_heading(times, crosswise, settings.heading_correlation_s):
        yield i, j, settings.heading_walk_rad**2 * part
    means, _, _ = _walk(times, settings.velocity_correlation_s)
    walked = settings.velocity_walk_mps**2 * _summed(_summed(means * np.outer(step, step)).T)
    _, _, wander = _walk(times, settings.position_correlation_s)
    along_axis = walked + settings.position_walk_m**2 * wander + settings.start_m**2
    yield from ((axis, axis, along_axis) for axis in (0, 1))


def edge_noise(time_s: float, length_m: float, settings: Settings) -> DeadReckoningNoise:
    """Return the standard deviations of one edge of this time and length, on a straight line: of its x along the track.

    They are for a graph with independent edges, which is too sure of poses many edges apart: see `covariance`.

    Raises:
        DriftError: the time is not above 0.
    """
    track = np.array([0.0, time_s]), np.array([[0.0, 0.0], [length_m, 0.0]])
    both = covariance(*track, settings)
    # the second pose in the frame of the first, which turns with its heading error
    relative = np.array([[-1.0, 0, 0, 1, 0, 0], [0, -1, -length_m, 0, 1, 0], [0, 0, -1, 0, 0, 1]])
    x, y, yaw = np.sqrt(np.diag(relative @ both @ relative.T)).tolist()
    roll, pitch, z = (
        math.sqrt(2) * noise for noise in (settings.roll_noise_rad, settings.pitch_noise_rad, settings.depth_noise_m)
    )
    return DeadReckoningNoise(roll, pitch, yaw, x, y, z)


def _track(time_s: np.ndarray, xy: np.ndarray, fix: Fix | None) -> tuple[np.ndarray, np.ndarray]:
    times, places = np.asarray(time_s, np.float64), np.asarray(xy, np.float64)
    if times.ndim != 1 or places.shape != (len(times), 2) or not len(times):
        raise DriftError(f"there are times {times.shape} and places {places.shape}, must be (n,) and (n, 2)")
    if fix is not None and fix.time_s < times[0]:
        times, places = np.append(fix.time_s, times), np.vstack([[fix.x_m, fix.y_m], places])
    if len(wrong := np.flatnonzero(~(np.diff(times) > 0))):
        raise DriftError(f"pose {wrong[0] + 1} has no later time than the one before it: times of poses must grow")
    return times - times[0], places


def _summed(rows: np.ndarray) -> np.ndarray:
    """Return the sums (n, ...) of edges (n - 1, ...) up to every pose."""
    return np.concatenate([np.zeros((1, *rows.shape[1:])), np.cumsum(rows, axis=0)])


def _of_heading(times: np.ndarray, crosswise: np.ndarray, correlation: float) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield the covariance of poses, as _parts does, for a walk of the heading of unit variance."""
    means, mixed, points = _walk(times, correlation)
    for i in (0, 1):
        for j in (0, 1):
            yield i, j, _summed(_summed(means * np.outer(crosswise[:, i], crosswise[:, j])).T).T
        with_yaw = _summed(mixed * crosswise[:, i, None])
        yield i, 2, with_yaw
        yield 2, i, with_yaw.T
    yield 2, 2, points


def _walk(times: np.ndarray, correlation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the covariances of a Gauss-Markov process of unit variance at n times and of its means between them.

    Of means (n - 1, n - 1), of means with points (n - 1, n), and of points (n, n).
    """
    t, step = times / correlation, np.diff(times) / correlation
    points = np.exp(-np.abs(t[:, None] - t))
    # of a mean over (a, b) with a point outside of it: exp(-gap) (1 - exp(-step)) / step, the gap from the nearer end
    share = -np.expm1(-step) / step
    gap = np.minimum(np.abs(t[:-1, None] - t), np.abs(t[1:, None] - t))
    mixed = share[:, None] * np.exp(-gap)
    between = np.maximum(t[:-1, None] - t[1:], t[:-1] - t[1:, None])  # from one's end to the other's start
    means = np.outer(share, share) * np.exp(-np.maximum(between, 0.0))
    np.fill_diagonal(means, _variance_of_mean(step))
    return means, mixed, points


def _variance_of_mean(step: np.ndarray) -> np.ndarray:
    # 2 (step - 1 + exp(-step)) / step^2; its series where that loses digits
    safe = np.maximum(step, 1e-3)
    return np.where(step < 1e-3, 1 - step / 3, 2 * (safe + np.expm1(-safe)) / safe**2)
