"""The pings of many raw files, as those of one survey: chosen, and in the order of time."""

import itertools
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pandas as pd

from pointnetkl.readers import projection
from pointnetkl.readers.spool import Spool
from pointnetkl.surveys.survey import SUBMAPS, SurveyError

DEEPEST_M = 12_000.0  # no seabed is deeper

_FASTEST_M_S, _JITTER_M = 100.0, 200.0  # a position farther off the track than this allows is damaged
# what processing may change: share of the swath's spread, metres, cosine of a turn
_ALIKE_SHARE, _ALIKE_M, _ALIKE_COS = 0.1, 10.0, 0.995
_HEADS = 9  # pings at one time that are compared with one another


class ArrangementError(SurveyError):
    """Raw files are not of one survey."""


def in_time_order(spools: Sequence[Spool]) -> list[Spool]:
    """Return the files by the time of their first ping; files without times (submaps, points) keep their order."""
    return sorted(spools, key=_begin)


def common(spools: Sequence[Spool]) -> tuple[str, str]:
    """Return the kind and the CRS of all files.

    Raises:
        ArrangementError: files with pings or soundings are of different kinds or in different CRS.
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
    source = (filled or spools)[0]
    return source.kind, source.crs


def usable(spools: Sequence[Spool], crs: str, kind: str, skipped: Counter[str]) -> pd.DataFrame:
    """Return the pings to use, in the order of time, and count in `skipped` those that are left out.

    The columns `file` and `source` are the name and the index of a ping's spool.
    """
    tables = [s.pings.assign(file=s.file, source=number) for number, s in enumerate(spools)]
    pings = pd.concat(tables, ignore_index=True)
    if pings.empty:
        return pings
    if kind == SUBMAPS:
        pings["time_s"] = np.arange(len(pings), dtype=np.float64)
    pings = _without(pings, ~np.isfinite(pings["time_s"]), "pings without a time", skipped)
    pings = _without(pings, _off_earth(pings, crs), "pings without a position on the earth", skipped)
    unknown = ~np.isfinite(pings["heading_rad"]) | ~(pings["depth_m"].abs() < DEEPEST_M)
    pings = _without(pings, unknown, "pings without a heading or depth", skipped)
    pings = pings.iloc[np.argsort(pings["time_s"].to_numpy(), kind="stable")]
    pings = _without(pings, _duplicates(pings), "pings that stand twice", skipped)
    pings = _without(pings, _in_earlier_files(pings, crs), "pings that another file has too", skipped)
    if kind != SUBMAPS:
        pings = _without(pings, _jumps(pings, crs), "pings far off the track", skipped)
    return pings.reset_index(drop=True)


def reordered(spools: Sequence[Spool]) -> int:
    """Return how many pings come after a later ping in their file."""
    times = (spool.pings["time_s"].to_numpy(np.float64) for spool in spools)
    finite = (time[np.isfinite(time)] for time in times)
    return sum(int(np.sum(time < np.maximum.accumulate(time))) for time in finite if len(time))


def _begin(spool: Spool) -> float:
    first = spool.pings["time_s"].min()
    return float(first) if np.isfinite(first) else np.inf


def _off_earth(pings: pd.DataFrame, crs: str) -> np.ndarray:
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


def _duplicates(pings: pd.DataFrame) -> np.ndarray:
    """Return which pings (n,) repeat an earlier ping of their file: the file holds a datagram twice."""
    # the heads of a sonar share time and place, but not their soundings
    columns = ["source", "time_s", "east", "north", "heading_rad", "count", "digest"]
    same_time = np.diff(pings["time_s"].to_numpy(), prepend=-np.inf) == 0
    rows = np.flatnonzero((same_time | np.append(same_time[1:], False)) & (pings["count"].to_numpy() > 0))
    copies = np.zeros(len(pings), bool)
    copies[rows] = pings.iloc[rows].duplicated(columns).to_numpy()
    return copies


def _in_earlier_files(pings: pd.DataFrame, crs: str) -> np.ndarray:
    """Return which pings (n,) an earlier file has as well: copied, or recorded by one program and processed by another.

    Pings at one time and place that see different ground are the heads of a sonar, in one file or in two.
    """
    time, source = pings["time_s"].to_numpy(), pings["source"].to_numpy()
    first = pings.groupby(["time_s", "count", "digest"], sort=False)["source"].transform("first").to_numpy()
    repeats = np.asarray(source != first)
    for step in range(1, min(_HEADS, len(pings))):
        row = np.flatnonzero((time[step:] == time[:-step]) & (source[step:] != source[:-step])) + step
        if len(row):
            repeats[row] |= _alike(pings.iloc[row], pings.iloc[row - step], crs)
    return repeats


def _alike(pings: pd.DataFrame, others: pd.DataFrame, crs: str) -> np.ndarray:
    """Return which pings (n,) equal the ping in the same row of `others`, apart from what processing changes."""
    east, north = (np.concatenate([table[name].to_numpy() for table in (pings, others)]) for name in ("east", "north"))
    if crs == projection.GEOGRAPHIC:
        east, north = projection.roughly(east, north)
    away = np.hypot(np.subtract(*np.split(east, 2)), np.subtract(*np.split(north, 2)))
    names = ("heading_rad", "middle_m", "spread_m", "count")
    (turned, aside, wider, more) = (pings[name].to_numpy() - others[name].to_numpy() for name in names)
    spread = _ALIKE_SHARE * others["spread_m"].to_numpy()
    seen = (np.abs(aside) <= spread) & (np.abs(wider) <= spread) & (more == 0)
    return np.asarray(seen & (away < _ALIKE_M) & (np.cos(turned) > _ALIKE_COS))


def _jumps(pings: pd.DataFrame, crs: str) -> np.ndarray:
    """Return which pings (n,) are farther from the median of five neighbours than any vehicle can move."""
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
    """Return which pings (n,) no vehicle can reach from the longest run of pings without a jump.

    The median of neighbours misses a run of wild positions, such as of a receiver that has lost its satellites, because
    such positions agree with one another.
    """

    def reachable(first: int, second: int) -> bool:
        distance = float(np.hypot(east[first] - east[second], north[first] - north[second]))
        return distance <= _JITTER_M + _FASTEST_M_S * abs(float(time[first] - time[second]))

    apart = np.hypot(np.diff(east), np.diff(north)) > _JITTER_M + _FASTEST_M_S * np.diff(time)
    runs = list(itertools.pairwise([0, *(1 + np.flatnonzero(apart)).tolist(), len(time)]))
    longest = max(range(len(runs)), key=lambda run: runs[run][1] - runs[run][0])
    lost = np.zeros(len(time), bool)
    before = after = runs[longest]
    for run in runs[longest + 1 :]:
        if reachable(before[1] - 1, run[0]):
            before = run
        else:
            lost[slice(*run)] = True
    for run in reversed(runs[:longest]):
        if reachable(after[0], run[1] - 1):
            after = run
        else:
            lost[slice(*run)] = True
    return lost
