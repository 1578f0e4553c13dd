"""A survey's track: its lines, and stretches of equal length along them.

A line ends at a gap between pings, or where the heading jumps: the turns between lines are often not logged.
Each line is cut from its start into stretches of exactly the wanted length; what is left at its end is a
stretch too if it has at least 90 % of that length, else it is counted and dropped.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

_SHORTEST = 0.9  # of a stretch's length: a shorter remainder of a line is dropped
_TURN_RAD = np.pi / 3  # no vehicle turns this far from one ping to the next: a turn was not logged
_STRAIGHT = 0.5  # least share of a stretch's length from its first ping to its last: else it points nowhere
_ROUNDING = 1e-9  # of a stretch's length


@dataclass(frozen=True)
class Stretch:
    """Consecutive pings, first to last (excluded): rows of the ping table."""

    first: int
    last: int
    middle: int  # the ping nearest to the stretch's middle
    line: int
    length_m: float
    yaw: float  # mean direction of the track, from the first ping to the last, radians
    straight: bool  # enough for that to mean something: not on a turn, nor where the vehicle hovers


@dataclass(frozen=True)
class Track:
    """The stretches of a survey, and what is left of its lines."""

    stretches: list[Stretch]
    lines: int
    longest_m: float  # line
    remainders: int  # ends of lines that are too short for a stretch
    pings_left: int  # in those


def cut(xy: np.ndarray, yaw: np.ndarray, length_m: float, max_gap_m: float) -> Track:
    """Cut the track through pings at `xy` (n, 2) metres, heading `yaw` (n,) radians, into stretches."""
    stretches: list[Stretch] = []
    longest, lines, remainders, left = 0.0, 0, 0, 0
    for line, (first, last) in enumerate(_lines(xy, yaw, max_gap_m)):
        here = xy[first:last]
        along = _along(here)
        edges, lengths = _edges(along, length_m)
        stretches += (
            _stretch(here, along, line, start, stop, length, first)
            for start, stop, length in zip(edges[:-1], edges[1:], lengths, strict=True)
        )
        longest, lines = max(longest, float(along[-1])), line + 1
        remainders, left = remainders + (edges[-1] < len(along)), left + len(along) - edges[-1]
    return Track(stretches, lines, longest, remainders, left)


def _lines(xy: np.ndarray, yaw: np.ndarray, max_gap_m: float) -> Iterator[tuple[int, int]]:
    turned = np.abs(np.angle(np.exp(1j * np.diff(yaw)))) > _TURN_RAD
    ends = 1 + np.flatnonzero(turned | (np.hypot(*np.diff(xy, axis=0).T) > max_gap_m))
    return zip([0, *ends.tolist()], [*ends.tolist(), len(xy)], strict=True)


def _along(xy: np.ndarray) -> np.ndarray:
    """Return the distance (n,) along the track through the pings, from the first of them."""
    return np.concatenate([[0.0], np.hypot(*np.diff(xy, axis=0).T).cumsum()])


def _edges(along: np.ndarray, length_m: float) -> tuple[list[int], list[float]]:
    """Return the k + 1 pings at which the line's k stretches start and end, and the stretches' lengths."""
    whole = int(along[-1] / length_m + _ROUNDING)
    remainder = float(along[-1] - whole * length_m)
    lengths = [length_m] * whole + [remainder] * bool(remainder >= _SHORTEST * length_m)
    edges = np.searchsorted(along, length_m * (np.arange(len(lengths) + 1) - _ROUNDING)).tolist()
    if len(lengths) > whole or (whole and remainder < _ROUNDING * length_m):
        edges[-1] = len(along)
    return edges, lengths


def _stretch(
    xy: np.ndarray, along: np.ndarray, line: int, start: int, stop: int, length_m: float, before: int
) -> Stretch:
    """Return the stretch of a line's pings start to stop, the line beginning `before` pings into the survey."""
    if start == stop:  # pings farther apart than a stretch is long
        return Stretch(before + start, before + stop, before + start, line, length_m, 0.0, straight=False)
    east, north = xy[stop - 1] - xy[start]
    middle = start + int(np.abs(along[start:stop] - 0.5 * (along[start] + along[stop - 1])).argmin())
    straight = bool(np.hypot(east, north) >= _STRAIGHT * length_m)
    yaw = float(np.arctan2(north, east))
    return Stretch(before + start, before + stop, before + middle, line, length_m, yaw, straight)
