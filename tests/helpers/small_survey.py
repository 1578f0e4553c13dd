"""A small survey of parallel lines over any seabed, with all its soundings."""

from collections.abc import Callable

import numpy as np
import pandas as pd

from whole_survey import Whole

Seabed = Callable[[np.ndarray, np.ndarray], np.ndarray]


def rolling(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of a gently rolling seabed, metres."""
    return -60 + 2 * np.sin(x / 15) * np.cos(y / 11)


def sail(
    lines: int = 2,
    line_m: float = 300.0,
    apart_m: float = 60.0,
    azimuth: float = 0.3,
    step_m: float = 1.0,
    beams: int = 60,
    swath_m: float = 80.0,
    seabed: Seabed = rolling,
    noise_m: float = 0.05,
    seed: int = 0,
) -> Whole:
    """Sail parallel lines to and fro over a seabed, 20 m below the surface; turns are not logged."""
    along = np.arange(0.0, line_m + step_m / 2, step_m)
    back = np.repeat(np.arange(lines) % 2, len(along)).astype(bool)
    u = np.where(back, line_m - np.tile(along, lines), np.tile(along, lines))
    v = np.repeat(apart_m * np.arange(lines), len(along))
    east, north = np.cos(azimuth), np.sin(azimuth)
    x, y = u * east - v * north, u * north + v * east
    pings = pd.DataFrame({"ping": np.arange(len(x), dtype=np.int32), "time_s": 1e9 + np.arange(len(x))})
    pings = pings.assign(x_m=x, y_m=y, z_m=-20.0, roll_rad=0.0, pitch_rad=0.0)
    pings = pings.assign(yaw_rad=azimuth + np.pi * back, file="small")
    across = np.tile(np.linspace(-swath_m / 2, swath_m / 2, beams), len(x))
    ping = np.repeat(np.arange(len(x)), beams)
    yaw = pings["yaw_rad"].to_numpy()[ping]
    px, py = x[ping] - across * np.sin(yaw), y[ping] + across * np.cos(yaw)
    pz = seabed(px, py) + noise_m * np.random.default_rng(seed).standard_normal(len(px))
    soundings = pd.DataFrame({"ping": ping.astype(np.int32), "beam": np.tile(np.arange(beams, dtype=np.int32), len(x))})
    soundings = soundings.assign(x_m=px, y_m=py, z_m=pz, quality=np.int8(0))
    return Whole(pings, soundings)
