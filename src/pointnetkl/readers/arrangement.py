"""The pings of many raw files as those of one survey: which are used, and in which order."""

import itertools
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pandas as pd

from pointnetkl.readers import projection
from pointnetkl.readers.spool import Spool
from pointnetkl.surveys.survey import SUBMAPS, SurveyError

DEEPEST_M = 12_000.0  # no seabed lies below

_FASTEST_M_S, _JITTER_M = 100.0, 200.0  # a position off the track by more than this is a damaged one
_ALIKE, _ALIKE_M, _ALIKE_COS = 0.1, 10.0, 0.995  # of the swath's spread, metres and the turn that processing changes
_HEADS = 9  # pings of one time, about: so many are compared with one another


class ArrangementError(SurveyError):
    """Raw files are not of one survey."""


def in_time_order(spools: Sequence[Spool]) -> list[Spool]:
    """Return the files by their first ping's time; submaps and points, which have none, as they are."""
    return sorted(spools, key=_begin)


def common(spools: Sequence[Spool]) -> tuple[str, str]:
    """Return the kind and the CRS of all files.

    Raises:
        ArrangementError: files that hold something are of different kinds or in different CRS.
    """
    filled = [s for s in spools if len(s.pings) or s.soundings]
    for spool in filled:
        if spool.kind != filled[0].kind:
            raise ArrangementError(
                f"{spool.file}: holds {spool.kind}, and {filled[0].file} {filled[0].kind}; make a survey of each kind"
            )
        if spool.crs != filled[0].crs:
            raise ArrangementError(
                f"{spool.file}: its coordinates are in {spool.crs}, those of {filled[0].file} in {filled[0].crs};"
                " bring the files of a survey to one coordinate system"
            )
    told = filled or spools
    return told[0].kind, told[0].crs


def usable(spools: Sequence[Spool], crs: str, kind: str, skipped: Counter[str]) -> pd.DataFrame:
    """Return the pings to use, in order of time; `file` and `source` say of which spool; counts what is left out."""
    tables = [s.pings.assign(file=s.file, source=number) for number, s in enumerate(spools)]
    pings = pd.concat(tables, ignore_index=True)
    if pings.empty:
        return pings
    if kind == SUBMAPS:
        pings["time_s"] = np.arange(len(pings), dtype=np.float64)
    pings = _without(pings, ~np.isfinite(pings["time_s"]), "pings without a time", skipped)
    pings = _without(pings, _nowhere(pings, crs), "pings without a position on the earth", skipped)
    unknown = ~np.isfinite(pings["heading_rad"]) | ~(pings["depth_m"].abs() < DEEPEST_M)
    pings = _without(pings, unknown, "pings without a heading or depth", skipped)
    pings = pings.iloc[np.argsort(pings["time_s"].to_numpy(), kind="stable")]
    pings = _without(pings, _copies(pings), "pings that stand twice", skipped)
    pings = _without(pings, _repeats(pings, crs), "pings that another file has too", skipped)
    if kind != SUBMAPS:
        pings = _without(pings, _jumps(pings, crs), "pings far off the track", skipped)
    return pings.reset_index(drop=True)


def reordered(spools: Sequence[Spool]) -> int:
    """Return how many pings stand in their files after a later one; they are used, in order of time."""
    times = (spool.pings["time_s"].to_numpy(np.float64) for spool in spools)
    known = (time[np.isfinite(time)] for time in times)
    return sum(int(np.sum(time < np.maximum.accumulate(time))) for time in known if len(time))


def _begin(spool: Spool) -> float:
    first = spool.pings["time_s"].min()
    return float(first) if np.isfinite(first) else np.inf


def _nowhere(pings: pd.DataFrame, crs: str) -> np.ndarray:
    east, north = pings["east"].to_numpy(), pings["north"].to_numpy()
    lost = ~np.isfinite(east + north)
    if crs == projection.GEOGRAPHIC:
        with np.errstate(invalid="ignore"):
            lost |= (np.abs(east) > 180) | (np.abs(north) > 90)
    return np.asarray(lost)


def _without(pings: pd.DataFrame, unusable: np.ndarray, reason: str, skipped: Counter[str]) -> pd.DataFrame:
    if count := int(np.sum(unusable)):
        skipped[reason] += count
        skipped["soundings of skipped pings"] += int(pings["count"][unusable].sum())
    return pings[~np.asarray(unusable)]


def _copies(pings: pd.DataFrame) -> np.ndarray:
    """Return which pings a file has had before, all the same: a datagram that it holds twice."""
    # the heads of a sonar share a time and a place, and never their soundings
    same = ["source", "time_s", "east", "north", "heading_rad", "count", "digest"]
    alike = np.diff(pings["time_s"].to_numpy(), prepend=-np.inf) == 0
    rows = np.flatnonzero((alike | np.append(alike[1:], False)) & (pings["count"].to_numpy() > 0))
    copies = np.zeros(len(pings), bool)
    copies[rows] = pings.iloc[rows].duplicated(same).to_numpy()
    return copies


def _repeats(pings: pd.DataFrame, crs: str) -> np.ndarray:
    """Return which pings an earlier file has as well: copied, or recorded by one program and processed by another.

    Pings of one time and place that see different ground are the heads of a sonar, be it in one file or in two.
    """
    time, source = pings["time_s"].to_numpy(), pings["source"].to_numpy()
    first = pings.groupby(["time_s", "count", "digest"], sort=False)["source"].transform("first").to_numpy()
    repeats = np.asarray(source != first)
    for step in range(1, min(_HEADS, len(pings))):
        row = np.flatnonzero((time[step:] == time[:-step]) & (source[step:] != source[:-step])) + step
        if len(row):
            repeats[row] |= _alike(pings.iloc[row], pings.iloc[row - step], crs)
    return repeats


def _alike(some: pd.DataFrame, others: pd.DataFrame, crs: str) -> np.ndarray:
    """Return which pings are those of the same row in another table, but for what processing changes."""
    east, north = (np.concatenate([table[name].to_numpy() for table in (some, others)]) for name in ("east", "north"))
    if crs == projection.GEOGRAPHIC:
        east, north = projection.roughly(east, north)
    away = np.hypot(np.subtract(*np.split(east, 2)), np.subtract(*np.split(north, 2)))
    names = ("heading_rad", "middle_m", "spread_m", "count")
    (turned, aside, wider, more) = (some[name].to_numpy() - others[name].to_numpy() for name in names)
    spread = _ALIKE * others["spread_m"].to_numpy()
    seen = (np.abs(aside) <= spread) & (np.abs(wider) <= spread) & (more == 0)
    return np.asarray(seen & (away < _ALIKE_M) & (np.cos(turned) > _ALIKE_COS))


def _jumps(pings: pd.DataFrame, crs: str) -> np.ndarray:
    """Return which pings lie farther from the median of five neighbours than any vehicle moves."""
    if len(pings) < 5:
        return np.zeros(len(pings), bool)
    time, east, north = (pings[name].to_numpy() for name in ("time_s", "east", "north"))
    if crs == projection.GEOGRAPHIC:
        east, north = projection.roughly(east, north)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad([time, east, north], ((0, 0), (2, 2)), "reflect"), 5, 1)
    off = np.hypot(east - np.median(windows[1], 1), north - np.median(windows[2], 1))
    off = np.asarray(off > _JITTER_M + _FASTEST_M_S * np.ptp(windows[0], 1))
    off[~off] = _unreachable(time[~off], east[~off], north[~off])
    return off


def _unreachable(time: np.ndarray, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Return which pings (n,) no vehicle comes to from the longest run of pings that one could have sailed.

    A run of wild positions, as of a receiver that has lost its satellites, would agree with itself.
    """

    def reached(one: int, other: int) -> bool:
        distance = float(np.hypot(east[one] - east[other], north[one] - north[other]))
        return distance <= _JITTER_M + _FASTEST_M_S * abs(float(time[one] - time[other]))

    apart = np.hypot(np.diff(east), np.diff(north)) > _JITTER_M + _FASTEST_M_S * np.diff(time)
    runs = list(itertools.pairwise([0, *(1 + np.flatnonzero(apart)).tolist(), len(time)]))
    longest = max(range(len(runs)), key=lambda run: runs[run][1] - runs[run][0])
    lost = np.zeros(len(time), bool)
    before = after = runs[longest]
    for run in runs[longest + 1 :]:
        if reached(before[1] - 1, run[0]):
            before = run
        else:
            lost[slice(*run)] = True
    for run in reversed(runs[:longest]):
        if reached(after[0], run[1] - 1):
            after = run
        else:
            lost[slice(*run)] = True
    return lost
