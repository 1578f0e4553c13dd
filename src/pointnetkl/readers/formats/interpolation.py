"""Navigation and attitude at the times of pings, between the samples on either side."""

import numpy as np


def linear(time: np.ndarray, known: np.ndarray, values: np.ndarray, gap_s: float) -> np.ndarray:
    """Return values (n,) at times (n,) from samples (m,) at known times, in any order; NaN where none is near.

    Near is between two samples at most `gap_s` apart, or beyond the first or last by no more than `gap_s`, where the
    nearest sample holds. Samples that are not finite do not count.
    """
    good = np.isfinite(known) & np.isfinite(values)
    if not good.any():
        return np.full(len(time), np.nan)
    known, values = known[good], values[good]
    if np.any(np.diff(known) <= 0):
        known, first = np.unique(known, return_index=True)  # sorted, and of one time the first
        values = values[first]
    after = np.searchsorted(known, time).clip(max=len(known) - 1)
    before = np.maximum(after - 1, 0)
    inside = (time >= known[0]) & (time <= known[-1])
    near = np.where(inside, known[after] - known[before], np.minimum(np.abs(time - known[0]), np.abs(time - known[-1])))
    return np.where((near <= gap_s) | (time == known[after]), np.interp(time, known, values), np.nan)


def angle(time: np.ndarray, known: np.ndarray, values: np.ndarray, gap_s: float) -> np.ndarray:
    """Return angles in radians, in [0, 2 pi), as `linear` does, the short way round between two samples."""
    east = linear(time, known, np.sin(values), gap_s)
    north = linear(time, known, np.cos(values), gap_s)
    return np.mod(np.arctan2(east, north), 2 * np.pi)


def longitude(time: np.ndarray, known: np.ndarray, values: np.ndarray, gap_s: float) -> np.ndarray:
    """Return longitudes in degrees, in [-180, 180), as `linear` does, the short way round between two samples."""
    if not np.isfinite(values).any():
        return np.full(len(time), np.nan)
    reference = values[np.isfinite(values)][0]  # exact, and not by sine and cosine: degrees are long
    turned = np.mod(values - reference + 180.0, 360.0) - 180.0
    return np.mod(linear(time, known, turned, gap_s) + reference + 180.0, 360.0) - 180.0
