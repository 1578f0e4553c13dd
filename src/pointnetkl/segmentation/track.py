"""A survey's track: its lines, and stretches of equal length along them.

A line ends at a gap between pings, at a turn, or where the heading jumps, because turns between lines are often not
logged. A turn is where the course over ground, from smoothed positions, changes faster than along a survey line.
Each line is cut from its start into stretches of one length. The remainder at its end is a stretch too if it has at
least 90 % of that length, else it is counted and dropped.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

_SHORTEST = 0.9  # of a stretch's length; a shorter remainder of a line is dropped
_TURN_RAD = np.pi / 3  # no vehicle turns so far from one ping to the next, so a turn was not logged
_STRAIGHT = 0.5  # least distance from the first ping to the last, of a stretch's length, for a direction
_ROUNDING = 1e-9  # of a stretch's length
_STEP = 0.05  # of a stretch's length; shorter moves may be noise, and at anchor are noise
_STRAY = 1.01  # a track longer than this, ping by ping over step by step, is lengthened by noise
_EVEN = 0.01  # of a stretch's length; turns are searched for in even steps of it
_COURSE = 0.25  # of a stretch's length, before and after a position, whose courses are compared
_LOCAL = 5  # even steps before and after a position, whose course is the local one
_SMOOTHED = 0.1  # of a stretch's length, over which positions are averaged


@dataclass(frozen=True)
class Stretch:
    """Consecutive pings, first to last (excluded): rows of the ping table."""

    first: int
    last: int
    middle: int  # the ping nearest to the stretch's middle
    line: int
    length_m: float
    yaw: float  # mean direction of the track, from the first ping to the last, radians
    straight: bool  # enough for `yaw` to be a direction: not on a turn, nor where the vehicle hovers


@dataclass(frozen=True)
class Track:
    """The stretches of a survey, and counts of what was left out."""

    stretches: list[Stretch]
    lines: int
    longest_m: float  # line
    remainders: int  # ends of lines that are too short for a stretch
    pings_dropped: int  # in those remainders
    pings_turning: int  # on turns, which belong to no line
    gaps: int  # in lines: steps that are too long and go on in the same direction
    missed_m: float  # in those gaps


def cut(xy: np.ndarray, yaw: np.ndarray, length_m: float, max_gap_m: float, max_turn_rad: float) -> Track:
    """Cut the track through pings at `xy` (n, 2) metres, heading `yaw` (n,) radians, into stretches.

    No step in a stretch is longer than `max_gap_m`, and its course does not change faster than by `max_turn_rad` over
    its length.
    """
    stretches: list[Stretch] = []
    longest, lines, remainders, pings_dropped, used = 0.0, 0, 0, 0, 0
    for line, (first, last) in enumerate(_lines(xy, yaw, length_m, max_gap_m, max_turn_rad)):
        positions = xy[first:last]
        along = _along(positions, _STEP * length_m)
        edges, lengths = _edges(along, length_m)
        stretches += (
            _stretch(positions, along, line, start, stop, length, first)
            for start, stop, length in zip(edges[:-1], edges[1:], lengths, strict=True)
        )
        longest, lines, used = max(longest, float(along[-1])), line + 1, used + len(along)
        remainders, pings_dropped = remainders + (edges[-1] < len(along)), pings_dropped + len(along) - edges[-1]
    gaps = _gaps(xy, yaw, max_gap_m)
    return Track(stretches, lines, longest, remainders, pings_dropped, len(xy) - used, len(gaps), float(gaps.sum()))


def _lines(
    xy: np.ndarray, yaw: np.ndarray, length_m: float, max_gap_m: float, max_turn_rad: float
) -> Iterator[tuple[int, int]]:
    """Yield the pings, first to last (excluded), of every line."""
    ends = 1 + np.flatnonzero(_jumped(yaw) | (_steps(xy) > max_gap_m))
    for first, last in itertools.pairwise([0, *ends.tolist(), len(xy)]):
        turning = _turning(xy[first:last], length_m, max_turn_rad)
        edges = first + np.flatnonzero(np.diff(turning, prepend=True, append=True))
        yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _jumped(yaw: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(np.angle(np.exp(1j * np.diff(yaw)))) > _TURN_RAD)


def _gaps(xy: np.ndarray, yaw: np.ndarray, max_gap_m: float) -> np.ndarray:
    """Return the lengths (k,) of the steps that are too long, without those from one line to another."""
    east, north = np.diff(xy, axis=0).T
    aside = np.abs(np.angle(np.exp(1j * (np.arctan2(north, east) - yaw[:-1])))) > _TURN_RAD
    length = np.hypot(east, north)
    return length[(length > max_gap_m) & ~aside & ~_jumped(yaw)]


def _turning(xy: np.ndarray, length_m: float, max_turn_rad: float) -> np.ndarray:
    """Return whether (n,) each ping lies where the course changes too fast; it takes half a length of track to see.

    The courses compared are those over a quarter of a length before the ping and after it. They come from positions and
    over distance, because headings are noisy and a slow vehicle pings often.
    """
    along, step, reach = _along(xy, _STEP * length_m), _EVEN * length_m, round(_COURSE / _EVEN)
    if along[-1] < 2 * reach * step:
        return np.zeros(len(xy), bool)
    distance, first = np.unique(along, return_index=True)
    even = step * np.arange(int(along[-1] / step + _ROUNDING) + 1)
    smooth = ndimage.uniform_filter1d(
        [np.interp(even, distance, values[first]) for values in xy.T], round(_SMOOTHED / _EVEN), mode="nearest"
    )
    course = (smooth[:, reach:] - smooth[:, :-reach]).T @ [1, 1j]
    local = (smooth[:, 2 * _LOCAL :] - smooth[:, : -2 * _LOCAL]).T @ [1, 1j]
    turning = _narrowed(course[:-reach], local[reach - _LOCAL : _LOCAL - reach], course[reach:], _COURSE * max_turn_rad)
    centre = np.clip(np.rint(along / step).astype(np.int64) - reach, 0, len(turning) - 1)
    return np.asarray(turning[centre])


def _narrowed(before: np.ndarray, local: np.ndarray, after: np.ndarray, limit_rad: float) -> np.ndarray:
    """Return whether (n,) the courses before and after each position, complex numbers, differ too much.

    Such positions begin and end on the straight lines beside a turn. Those whose local course is still the one before,
    or already the one after, are not counted.
    """
    turning = _angle_between(before, after) > limit_rad
    edges = np.flatnonzero(np.diff(turning, prepend=False, append=False))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        departed = _angle_between(local[first:last], before[first]) > limit_rad / 2
        underway = _angle_between(local[first:last], after[last - 1]) > limit_rad / 2
        begin = int(departed.argmax()) if first > 0 else 0
        end = int(underway[::-1].argmax()) if last < len(turning) else 0
        turning[first : first + min(begin, last - first - end - 1)] = False
        turning[last - end : last] = False
    return turning


def _angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(np.angle(a * np.conj(b))))


def _along(xy: np.ndarray, least_m: float) -> np.ndarray:
    """Return the distance (n,) along the track from the first ping to each; it never decreases.

    Where noise lengthens the track, the distance is measured in steps from a ping to the first one `least_m` away.
    """
    along = np.concatenate([[0.0], _steps(xy).cumsum()])
    coarse = np.searchsorted(along, np.arange(0.0, along[-1], least_m)).tolist()
    straight = along[-1] <= _STRAY * _steps(xy[[*coarse, len(xy) - 1]]).sum()
    return along if straight else _along_in_steps(xy, least_m)


def _steps(xy: np.ndarray) -> np.ndarray:
    return np.asarray(np.hypot(*np.diff(xy, axis=0).T))


def _along_in_steps(xy: np.ndarray, least_m: float) -> np.ndarray:
    along, covered, (x, y) = [], 0.0, xy[0].tolist()
    for position in xy.tolist():
        step = math.hypot(position[0] - x, position[1] - y)
        along.append(covered + step)
        if step >= least_m:
            covered, (x, y) = covered + step, position
    return np.maximum.accumulate(along)


def _edges(along: np.ndarray, length_m: float) -> tuple[list[int], list[float]]:
    """Return the k + 1 pings at which the line's k stretches start and end, and the stretches' lengths."""
    full = int(along[-1] / length_m + _ROUNDING)
    remainder = float(along[-1] - full * length_m)
    lengths = [length_m] * full + [remainder] * bool(remainder >= _SHORTEST * length_m)
    edges = np.searchsorted(along, length_m * (np.arange(len(lengths) + 1) - _ROUNDING)).tolist()
    if len(lengths) > full or (full and remainder < _ROUNDING * length_m):
        edges[-1] = len(along)
    return edges, lengths


def _stretch(
    xy: np.ndarray, along: np.ndarray, line: int, start: int, stop: int, length_m: float, before: int
) -> Stretch:
    """Return the stretch of a line's pings start to stop (excluded); `before` pings of the survey precede the line."""
    if start == stop:  # its pings are farther apart than a stretch is long
        return Stretch(before + start, before + stop, before + start, line, length_m, 0.0, straight=False)
    east, north = xy[stop - 1] - xy[start]
    middle = start + int(np.abs(along[start:stop] - 0.5 * (along[start] + along[stop - 1])).argmin())
    straight = bool(np.hypot(east, north) >= _STRAIGHT * length_m)
    yaw = float(np.arctan2(north, east))
    return Stretch(before + start, before + stop, before + middle, line, length_m, yaw, straight)
