"""Navigation and attitude at the times of pings, interpolated between the samples on either side."""

import numpy as np


def linear(time: np.ndarray, sampled: np.ndarray, values: np.ndarray, gap_s: float) -> np.ndarray:
    """Return values (n,) at times `time` (n,), from samples `values` (m,) at times `sampled` (m,), in any order.

    Values are linear between two samples at most `gap_s` apart; up to `gap_s` beyond the first or the last sample, that
    sample holds; elsewhere they are NaN. Samples that are not finite are ignored.
    """
    good = np.isfinite(sampled) & np.isfinite(values)
    if not good.any():
        return np.full(len(time), np.nan)
    sampled, values = sampled[good], values[good]
    if np.any(np.diff(sampled) <= 0):
        sampled, first = np.unique(sampled, return_index=True)  # sorted, the first of each time
        values = values[first]
    after = np.searchsorted(sampled, time).clip(max=len(sampled) - 1)
    before = np.maximum(after - 1, 0)
    inside = (time >= sampled[0]) & (time <= sampled[-1])
    gap = np.where(
        inside, sampled[after] - sampled[before], np.minimum(np.abs(time - sampled[0]), np.abs(time - sampled[-1]))
    )
    return np.where((gap <= gap_s) | (time == sampled[after]), np.interp(time, sampled, values), np.nan)


def angle(time: np.ndarray, sampled: np.ndarray, values: np.ndarray, gap_s: float) -> np.ndarray:
    """Return angles in radians, in [0, 2 pi), as `linear` does, along the shorter arc between two samples."""
    east = linear(time, sampled, np.sin(values), gap_s)
    north = linear(time, sampled, np.cos(values), gap_s)
    return np.mod(np.arctan2(east, north), 2 * np.pi)


def longitude(time: np.ndarray, sampled: np.ndarray, values: np.ndarray, gap_s: float) -> np.ndarray:
    """Return longitudes in degrees, in [-180, 180), as `linear` does, along the shorter arc between two samples."""
    if not np.isfinite(values).any():
        return np.full(len(time), np.nan)
    reference = values[np.isfinite(values)][0]  # no sine and cosine here: their rounding is metres on the ground
    turned = np.mod(values - reference + 180.0, 360.0) - 180.0
    return np.mod(linear(time, sampled, turned, gap_s) + reference + 180.0, 360.0) - 180.0
