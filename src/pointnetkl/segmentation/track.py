"""A survey's track: its lines, and stretches of equal length along them.

A line ends at a gap between pings, at a turn, or where the heading jumps: turns between lines are often not logged.
A turn is where the course over ground, from smoothed positions, changes faster than a survey line's does.
Each line is cut from its start into stretches of exactly the wanted length; what is left at its end is a
stretch too if it has at least 90 % of that length, else it is counted and dropped.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

_SHORTEST = 0.9  # of a stretch's length: a shorter remainder of a line is dropped
_TURN_RAD = np.pi / 3  # no vehicle turns this far from one ping to the next: a turn was not logged
_STRAIGHT = 0.5  # least share of a stretch's length from its first ping to its last: else it points nowhere
_ROUNDING = 1e-9  # of a stretch's length
_STEP = 0.05  # of a stretch's length: moves below it may be noise, and at anchor are
_STRAY = 1.01  # a track that is longer by this factor ping by ping than by such steps is made longer by noise
_EVEN = 0.01  # of a stretch's length: the even steps by which turns are looked for
_COURSE = 0.25  # of a stretch's length, before a place and after it, whose courses tell a turn
_HERE = 5  # even steps before a place and after it, whose course is the one there
_SMOOTHED = 0.1  # of a stretch's length, over which positions are averaged for that


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
    pings_turning: int  # on turns, which belong to no line
    gaps: int  # in lines: longer steps, that go on the same way
    missed_m: float  # in those


def cut(xy: np.ndarray, yaw: np.ndarray, length_m: float, max_gap_m: float, max_turn_rad: float) -> Track:
    """Cut the track through pings at `xy` (n, 2) metres, heading `yaw` (n,) radians, into stretches.

    No step of theirs is longer than `max_gap_m`, and their course does not change faster than by `max_turn_rad` over
    one's length.
    """
    stretches: list[Stretch] = []
    longest, lines, remainders, left, used = 0.0, 0, 0, 0, 0
    for line, (first, last) in enumerate(_lines(xy, yaw, length_m, max_gap_m, max_turn_rad)):
        here = xy[first:last]
        along = _along(here, _STEP * length_m)
        edges, lengths = _edges(along, length_m)
        stretches += (
            _stretch(here, along, line, start, stop, length, first)
            for start, stop, length in zip(edges[:-1], edges[1:], lengths, strict=True)
        )
        longest, lines, used = max(longest, float(along[-1])), line + 1, used + len(along)
        remainders, left = remainders + (edges[-1] < len(along)), left + len(along) - edges[-1]
    gaps = _gaps(xy, yaw, max_gap_m)
    return Track(stretches, lines, longest, remainders, left, len(xy) - used, len(gaps), float(gaps.sum()))


def _lines(
    xy: np.ndarray, yaw: np.ndarray, length_m: float, max_gap_m: float, max_turn_rad: float
) -> Iterator[tuple[int, int]]:
    """Yield the pings, first to last (excluded), of every line."""
    ends = 1 + np.flatnonzero(_turned(yaw) | (_steps(xy) > max_gap_m))
    for first, last in itertools.pairwise([0, *ends.tolist(), len(xy)]):
        turning = _turning(xy[first:last], length_m, max_turn_rad)
        edges = first + np.flatnonzero(np.diff(turning, prepend=True, append=True))
        yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _turned(yaw: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(np.angle(np.exp(1j * np.diff(yaw)))) > _TURN_RAD)


def _gaps(xy: np.ndarray, yaw: np.ndarray, max_gap_m: float) -> np.ndarray:
    """Return the lengths (k,) of the steps that are too long, but for those from one line to another."""
    east, north = np.diff(xy, axis=0).T
    aside = np.abs(np.angle(np.exp(1j * (np.arctan2(north, east) - yaw[:-1])))) > _TURN_RAD
    length = np.hypot(east, north)
    return length[(length > max_gap_m) & ~aside & ~_turned(yaw)]


def _turning(xy: np.ndarray, length_m: float, max_turn_rad: float) -> np.ndarray:
    """Return which pings (n,) lie where the course changes too fast, to be told from half a length of track or more.

    The courses are those from a quarter of a length before to the ping, and on to as much after it. By positions and
    over distance, for headings are noisy, and a slow vehicle pings often.
    """
    along, step, reach = _along(xy, _STEP * length_m), _EVEN * length_m, round(_COURSE / _EVEN)
    if along[-1] < 2 * reach * step:
        return np.zeros(len(xy), bool)
    way, first = np.unique(along, return_index=True)
    even = step * np.arange(int(along[-1] / step + _ROUNDING) + 1)
    smooth = ndimage.uniform_filter1d(
        [np.interp(even, way, values[first]) for values in xy.T], round(_SMOOTHED / _EVEN), mode="nearest"
    )
    course = (smooth[:, reach:] - smooth[:, :-reach]).T @ [1, 1j]
    here = (smooth[:, 2 * _HERE :] - smooth[:, : -2 * _HERE]).T @ [1, 1j]
    turning = _narrowed(course[:-reach], here[reach - _HERE : _HERE - reach], course[reach:], _COURSE * max_turn_rad)
    centre = np.clip(np.rint(along / step).astype(np.int64) - reach, 0, len(turning) - 1)
    return np.asarray(turning[centre])


def _narrowed(before: np.ndarray, here: np.ndarray, after: np.ndarray, limit_rad: float) -> np.ndarray:
    """Return where (n,) the courses before and after, as complex numbers, differ by more than the limit.

    A place counts only where the course has left the one before and has not come to the one after, because such places
    begin on the straight line.
    """
    turning = _apart(before, after) > limit_rad
    edges = np.flatnonzero(np.diff(turning, prepend=False, append=False))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        left = _apart(here[first:last], before[first]) > limit_rad / 2
        right = _apart(here[first:last], after[last - 1]) > limit_rad / 2
        begin = int(left.argmax()) if first > 0 else 0
        end = int(right[::-1].argmax()) if last < len(turning) else 0
        turning[first : first + min(begin, last - first - end - 1)] = False
        turning[last - end : last] = False
    return turning


def _apart(some: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(np.angle(some * np.conj(others))))


def _along(xy: np.ndarray, least_m: float) -> np.ndarray:
    """Return the distance (n,) along the track through the pings, from the first of them; it never decreases.

    Where noise makes that longer, it is measured from one ping to the first that is `least_m` from it.
    """
    along = np.concatenate([[0.0], _steps(xy).cumsum()])
    some = np.searchsorted(along, np.arange(0.0, along[-1], least_m)).tolist()
    straight = along[-1] <= _STRAY * _steps(xy[[*some, len(xy) - 1]]).sum()
    return along if straight else _made_good(xy, least_m)


def _steps(xy: np.ndarray) -> np.ndarray:
    return np.asarray(np.hypot(*np.diff(xy, axis=0).T))


def _made_good(xy: np.ndarray, least_m: float) -> np.ndarray:
    along, made, (x, y) = [], 0.0, xy[0].tolist()
    for here in xy.tolist():
        away = math.hypot(here[0] - x, here[1] - y)
        along.append(made + away)
        if away >= least_m:
            made, (x, y) = made + away, here
    return np.maximum.accumulate(along)


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
