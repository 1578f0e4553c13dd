"""Navigation of simulated vehicles, sailed many times over a plane, without a sonar."""

import numpy as np

from pointnetkl.simulation import vehicle
from pointnetkl.simulation.sonar import Settings as Sonar
from pointnetkl.slam.closing import drift

STRAIGHT = np.arange(21) * 50.0, np.column_stack([np.arange(21) * 100.0, np.zeros(21)])
LAYOUT = vehicle.Layout(5, 1000.0, 36.0, 20.0, 0.0, -20.0)
APART = 77  # pings from pose to pose


class Plane:
    """A seabed without relief."""

    crs = "EPSG:32632"

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the height (n,) at x and y, metres."""
        return np.full(np.broadcast(x, y).shape, -600.0)

    def place(self, length_m: float, width_m: float, azimuth: float) -> tuple[float, float]:
        """Return the centre of a survey."""
        return 0.0, 0.0


def of_vehicle(navigation: vehicle.Navigation) -> drift.Settings:
    """Return the drift of a simulated vehicle."""
    heading, correlation = np.deg2rad(navigation.heading_error_deg), navigation.correlation_s
    return drift.Settings(
        navigation.scale_error, heading, heading, correlation, navigation.velocity_error_mps, correlation
    )


def sailed(navigation: vehicle.Navigation, seeds: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, drift.Fix]:
    """Return times (n,), places (n, 2) and errors (seeds, n, 3) of poses along a lawnmower, and where it began."""
    attitude = vehicle.Attitude(1.5, 1.5, 1.0, 18.0, 0.005, 1.0)
    sonar = Sonar(110.0, 512, 0.03, 1.0, 3.0, 0.01, 0.004, 2.0, 0.98)
    settings, rng = vehicle.Settings(2.0, attitude, navigation, sonar), np.random.default_rng(5)
    track = vehicle.sail(vehicle.lines(LAYOUT, rng), LAYOUT.azimuth_deg, 1.3, 70.0, settings, Plane(), rng)
    poses = np.arange(APART // 2, len(track.x), APART)
    true, errors = np.column_stack([track.x, track.y, track.yaw]), []
    for seed in range(seeds):
        reckoned = np.column_stack(vehicle.dead_reckoned(track, navigation, np.random.default_rng([9, seed])))
        errors.append((reckoned - true)[poses])
    fix = drift.Fix(float(track.time_s[0]), float(track.x[0]), float(track.y[0]))
    return track.time_s[poses], true[poses, :2], np.array(errors), fix
