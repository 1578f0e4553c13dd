"""Outliers: soundings that disagree with their neighbours in their own ping and in the pings beside it.

The filter follows Hampel (1974), along the swath. A sounding is suspect if its depth differs from the median of the
neighbouring beams, after their slope is removed, by more than a share of that depth and by more than a number of robust
standard deviations. A rock, a wall or a wreck is seen by several soundings: a suspect stays if others in its ping or in
the pings beside it deviate likewise. Outliers are flagged, not removed. `spacing.outlying` finds smaller errors later.
"""

from dataclasses import dataclass

import numpy as np

from pointnetkl.workflow import parameters

_SIDE = 5  # neighbouring beams on either side of a sounding
PINGS = 2  # before and after a ping that are searched for company; with two heads every other ping is the other head's
_COMPANY = 2  # soundings that must deviate like a suspect for it to be kept
_ALIKE = 0.5  # a sounding deviates likewise if its deviation is that of the suspect to within this share
_NEAR = 2.5  # beam spacings across track within which soundings count as company
_POINT_M = 1e-3  # soundings that are closer are at one place
_TO_SIGMA = 1.4826  # standard deviation of a Gaussian per median absolute deviation


@dataclass(frozen=True)
class Settings:
    """Group `outliers` of section `ingest`: the deviation from its neighbours that makes a sounding an outlier.

    Raises:
        ValueError: a number is negative, or the share above 1.
    """

    sigmas: float  # robust standard deviations; 0 switches the filter off
    depth_share: float  # of the depth below the sonar

    def __post_init__(self) -> None:
        """Refuse numbers out of range."""
        parameters.require_within(self, 0.0, np.inf, "sigmas")
        parameters.require_within(self, 0.0, 1.0, "depth_share")


NONE = Settings(0.0, 0.0)


def outlying(ping: np.ndarray, across: np.ndarray, down: np.ndarray, settings: Settings) -> np.ndarray:
    """Return which soundings (n,) are outliers.

    The soundings are those of whole pings in order; `across` and `down` are metres to starboard and down. Beams may be
    in any order within a ping. The result for a ping depends on the PINGS before and after it, and on no others.
    """
    outlier = np.zeros(len(ping), bool)
    if settings.sigmas > 0 and len(ping) > 2 * _SIDE:
        order = np.lexsort((across, ping))
        outlier[order[_Swaths(ping[order], across[order], down[order]).outliers(settings)]] = True
    return outlier


@dataclass(frozen=True)
class _Suspects:
    """Soundings (k,) that deviate from their neighbours."""

    row: np.ndarray
    deviation_m: np.ndarray  # how much deeper than its neighbours a sounding is
    slope: np.ndarray  # of the neighbours, down per metre to starboard
    spacing_m: np.ndarray  # of the neighbours' beams


class _Swaths:
    """Soundings in order of ping and, within it, across track."""

    def __init__(self, ping: np.ndarray, across: np.ndarray, down: np.ndarray) -> None:
        self._ping, self._across, self._down = ping.astype(np.int64) - ping[0], across, down
        begins = np.flatnonzero(np.diff(self._ping, prepend=-1))
        count = np.diff(begins, append=len(ping))
        self._first, self._count = np.repeat(begins, count), np.repeat(count, count)

    def outliers(self, settings: Settings) -> np.ndarray:
        """Return the rows of outliers."""
        row = self._candidates(settings.depth_share)
        window, short = self._neighbours(row)
        depth, away = self._down[window], self._across[window] - self._across[row, None]
        slope = _slope(away, depth)
        depth -= slope[:, None] * away
        median = np.median(depth, axis=1)
        deviation = self._down[row] - median
        sigma = _TO_SIGMA * np.median(np.abs(depth - median[:, None]), axis=1)
        width = np.ptp(away, axis=1) / (2 * _SIDE)
        far = ~short & (np.abs(deviation) > np.maximum(settings.depth_share * np.abs(median), settings.sigmas * sigma))
        suspects = _Suspects(row[far], deviation[far], slope[far], width[far])
        return suspects.row[self._company(suspects) < _COMPANY]

    def _candidates(self, share: float) -> np.ndarray:
        """Return the rows to test: those half as far off a median of five, and those next to the edge of a swath.

        The outermost beams are never tested: whether the ground falls away beyond the swath is not known.
        """
        off = np.abs(self._down - _median_of_five(self._down))
        before = np.arange(len(off)) - self._first
        inner = np.minimum(before, self._count - 1 - before)
        return np.flatnonzero((inner > 0) & ((off > 0.5 * share * np.abs(self._down)) | (inner == 1)))

    def _neighbours(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the neighbours (k, 2 _SIDE + 1) of rows, within their ping, and which (k,) pings are too short."""
        size = 2 * _SIDE + 1
        last = self._first[row] + np.maximum(self._count[row] - size, 0)
        start = np.clip(row - _SIDE, self._first[row], last)
        window = start[:, None] + np.arange(size)
        return np.minimum(window, len(self._ping) - 1), self._count[row] < size

    def _company(self, suspects: _Suspects) -> np.ndarray:
        """Return how many soundings (k,) beside each suspect deviate likewise."""
        # complex numbers are sorted by their real part, then by their imaginary part
        place, across = self._ping + 1j * self._across, self._across[suspects.row]
        count = np.zeros(len(suspects.row), np.int64)
        for step in range(-PINGS, PINGS + 1):
            ping = self._ping[suspects.row] + step
            near = np.searchsorted(place, ping + 1j * across)
            for other in (near - 2, near - 1, near, near + 1, near + 2):
                inside = (other >= 0) & (other < len(place))
                count += inside & self._beside(suspects, np.where(inside, other, 0), ping)
        return count

    def _beside(self, suspects: _Suspects, other: np.ndarray, ping: np.ndarray) -> np.ndarray:
        away = self._across[other] - self._across[suspects.row]
        near = (self._ping[other] == ping) & (other != suspects.row) & (np.abs(away) <= _NEAR * suspects.spacing_m)
        deviation = self._down[other] - self._down[suspects.row] - suspects.slope * away + suspects.deviation_m
        return np.asarray(near & (np.abs(deviation / suspects.deviation_m - 1.0) <= _ALIKE))


def _slope(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the slope (k,) of rows (k, 2 _SIDE + 1) through the medians of their halves: outliers hardly change it."""
    run, rise = (np.median(v[:, -_SIDE:], axis=1) - np.median(v[:, :_SIDE], axis=1) for v in (x, y))
    return np.asarray(rise / np.maximum(run, _POINT_M))


def _median_of_five(values: np.ndarray) -> np.ndarray:
    """Return the running median of five, by comparisons alone: much faster than sorting."""
    padded = np.pad(values, 2, "edge")
    a, b, c, d, e = (padded[k : len(values) + k] for k in range(5))
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.asarray(np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e)))
