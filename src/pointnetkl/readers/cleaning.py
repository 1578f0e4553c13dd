"""Soundings that their own ping and the pings beside it belie: gross errors, found before submaps are cut.

A filter after Hampel (1974) along the swath. A sounding is suspect when its depth differs from that of the beams about
it, the median once their slope is taken out, by more than a share of it and by more than some of their robust standard
deviations. What other soundings of its ping or of the pings beside it have as well, a rock, a wall, a wreck, is no
error: a suspect that has company is kept. Nothing is removed, only flagged; what is smaller than that is left to
`spacing.outlying`.
"""

from dataclasses import dataclass

import numpy as np

from pointnetkl.workflow import parameters

_SIDE = 5  # beams on either side that a beam is judged by
PINGS = 2  # before and after, whose soundings keep a suspect company: with two heads every other one is the other's
_COMPANY = 2  # soundings that a suspect must have beside it to be kept
_ALIKE = 0.5  # of the way from the median to the suspect: company has gone as far, give or take so much
_NEAR = 2.5  # spacings of beams across track: so near is beside
_POINT_M = 1e-3  # soundings that lie closer are at one place
_TO_SIGMA = 1.4826  # from a median absolute deviation, for a Gaussian


@dataclass(frozen=True)
class Settings:
    """Group `outliers` of section `ingest`: how far off the beams about it a sounding is a gross error.

    Raises:
        ValueError: a number is negative, or the share above 1.
    """

    sigmas: float  # robust standard deviations; 0: none is looked for
    depth_share: float  # of the depth below the sonar

    def __post_init__(self) -> None:
        """Refuse numbers that no filter can have."""
        parameters.require_within(self, 0.0, np.inf, "sigmas")
        parameters.require_within(self, 0.0, 1.0, "depth_share")


NONE = Settings(0.0, 0.0)


def outlying(ping: np.ndarray, across: np.ndarray, down: np.ndarray, how: Settings) -> np.ndarray:
    """Return which (n,) soundings are gross errors, of whole pings in order: metres to starboard and down.

    Beams may stand in any order within their ping. The verdict on a ping is the same with any others before and after
    it, if those PINGS on either side are among them.
    """
    wrong = np.zeros(len(ping), bool)
    if how.sigmas > 0 and len(ping) > 2 * _SIDE:
        order = np.lexsort((across, ping))
        wrong[order[_Swaths(ping[order], across[order], down[order]).alone(how)]] = True
    return wrong


@dataclass(frozen=True)
class _Suspects:
    """Soundings (k,) that are far off the beams about them."""

    row: np.ndarray
    off: np.ndarray  # metres deeper than those
    slope: np.ndarray  # of those
    width: np.ndarray  # metres from beam to beam


class _Swaths:
    """Soundings in order of ping and, within it, across track."""

    def __init__(self, ping: np.ndarray, across: np.ndarray, down: np.ndarray) -> None:
        self._ping, self._across, self._down = ping.astype(np.int64) - ping[0], across, down
        begins = np.flatnonzero(np.diff(self._ping, prepend=-1))
        count = np.diff(begins, append=len(ping))
        self._first, self._count = np.repeat(begins, count), np.repeat(count, count)

    def alone(self, how: Settings) -> np.ndarray:
        """Return the rows of gross errors."""
        row = self._odd(how.depth_share)
        window, short = self._about(row)
        depth, away = self._down[window], self._across[window] - self._across[row, None]
        slope = _slope(away, depth)
        depth -= slope[:, None] * away
        median = np.median(depth, axis=1)
        off = self._down[row] - median
        sigma = _TO_SIGMA * np.median(np.abs(depth - median[:, None]), axis=1)
        width = np.ptp(away, axis=1) / (2 * _SIDE)
        far = ~short & (np.abs(off) > np.maximum(how.depth_share * np.abs(median), how.sigmas * sigma))
        of = _Suspects(row[far], off[far], slope[far], width[far])
        return of.row[self._company(of) < _COMPANY]

    def _odd(self, share: float) -> np.ndarray:
        """Return the rows that need the whole test: half as far off the median of five, or next to a swath's edge.

        The outermost beams have none: nothing tells whether the ground falls away beyond the others.
        """
        off = np.abs(self._down - _median_of_five(self._down))
        before = np.arange(len(off)) - self._first
        inner = np.minimum(before, self._count - 1 - before)
        return np.flatnonzero((inner > 0) & ((off > 0.5 * share * np.abs(self._down)) | (inner == 1)))

    def _about(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows (k, 2 side + 1) about some, within their ping, and of which pings are shorter than that."""
        size = 2 * _SIDE + 1
        last = self._first[row] + np.maximum(self._count[row] - size, 0)
        start = np.clip(row - _SIDE, self._first[row], last)
        window = start[:, None] + np.arange(size)
        return np.minimum(window, len(self._ping) - 1), self._count[row] < size

    def _company(self, of: _Suspects) -> np.ndarray:
        """Return how many soundings beside each suspect have gone the same way about as far."""
        # complex numbers are in order of their real part, and then of their imaginary one
        place, across = self._ping + 1j * self._across, self._across[of.row]
        found = np.zeros(len(of.row), np.int64)
        for step in range(-PINGS, PINGS + 1):
            ping = self._ping[of.row] + step
            near = np.searchsorted(place, ping + 1j * across)
            for other in (near - 2, near - 1, near, near + 1, near + 2):
                inside = (other >= 0) & (other < len(place))
                found += inside & self._beside(of, np.where(inside, other, 0), ping)
        return found

    def _beside(self, of: _Suspects, other: np.ndarray, ping: np.ndarray) -> np.ndarray:
        away = self._across[other] - self._across[of.row]
        there = (self._ping[other] == ping) & (other != of.row) & (np.abs(away) <= _NEAR * of.width)
        gone = self._down[other] - self._down[of.row] - of.slope * away + of.off
        return np.asarray(there & (np.abs(gone / of.off - 1.0) <= _ALIKE))


def _slope(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the slope (k,) through the medians of both halves of each row (k, 2 side + 1), which few blunders turn."""
    run, rise = (np.median(v[:, -_SIDE:], axis=1) - np.median(v[:, :_SIDE], axis=1) for v in (x, y))
    return np.asarray(rise / np.maximum(run, _POINT_M))


def _median_of_five(values: np.ndarray) -> np.ndarray:
    """Return the running median, by comparisons alone: many times as fast as sorting each five."""
    padded = np.pad(values, 2, "edge")
    a, b, c, d, e = (padded[k : len(values) + k] for k in range(5))
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.asarray(np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e)))
