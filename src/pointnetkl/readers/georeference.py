"""From what raw files hold, navigation and soundings relative to the vehicle, to a survey in one map frame."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from pointnetkl import pose
from pointnetkl.readers import projection
from pointnetkl.survey import PINGS, SOUNDINGS, Survey, SurveyError

REJECTED, IMPOSSIBLE = 1, 2  # quality of a sounding: refused by the sonar or its operator; by a check of ours

_FASTEST_M_S, _JITTER_M = 100.0, 200.0  # a position off the track by more than this is a damaged one
_DEEPEST_M, _HIGHEST_M, _FARTHEST_M = 12_000.0, 100.0, 30_000.0  # no seabed lies beyond
_WIDEST_M = 1e6  # extent of a survey, which no map projection serves beyond
_TOLD = 20  # of the sentences on damage, the others are only counted


class GeoreferenceError(SurveyError):
    """Raw files do not make a survey: nothing usable, or no common coordinates."""


@dataclass(frozen=True)
class Recording:
    """What one raw file holds, before it has a place on the map.

    `pings` has columns time_s; east, north (longitude and latitude in degrees where crs is
    projection.GEOGRAPHIC, else metres); depth_m (of the vehicle, positive down); roll_rad, pitch_rad (NaN:
    not recorded); heading_rad (clockwise from true north, or from grid north where the crs is projected).
    `soundings` has columns ping (row of `pings`), beam, along_m (forward), across_m (to starboard), down_m
    (below the vehicle), quality; levelled, not turned by the heading.
    """

    file: str
    crs: str
    pings: pd.DataFrame
    soundings: pd.DataFrame
    skipped: dict[str, int] = field(default_factory=dict)  # counts by reason
    problems: list[str] = field(default_factory=list)  # sentences that name file, byte and cause


def survey(recordings: Sequence[Recording], zone: str) -> Survey:
    """Put recordings together in the order of time; `zone` is the CRS for longitudes and latitudes, or "auto".

    Raises:
        GeoreferenceError: no usable ping is left, or the files have different coordinate systems.
        projection.ProjectionError: the zone is not a projected CRS in metres.
    """
    recordings = sorted(recordings, key=_begin)
    skipped: Counter[str] = Counter()
    for recording in recordings:
        skipped.update(recording.skipped)
    crs = _common_crs(recordings)
    read = _all_pings(recordings)
    pings = _usable(read, crs, skipped)
    if pings.empty:
        raise GeoreferenceError(_nothing(recordings, skipped))
    frame = projection.frame(crs, zone, pings["east"].to_numpy(), pings["north"].to_numpy())
    origin = (float(np.round(frame.x[0])), float(np.round(frame.y[0])))
    if (extent := float(np.max(np.hypot(frame.x - origin[0], frame.y - origin[1])))) > _WIDEST_M:
        raise GeoreferenceError(
            f"{', '.join(sorted(set(pings['file']))[:5])}: pings lie {extent / 1000:.0f} km apart; read what is far"
            " away as surveys of their own"
        )
    soundings = _soundings(recordings, pings, frame, origin, skipped)
    report = _report(recordings, len(read), soundings, skipped)
    return Survey(_ping_table(pings, frame, origin), soundings, frame.crs, origin, report)


def _begin(recording: Recording) -> tuple[float, str]:
    first = recording.pings["time_s"].min()
    return (float(first) if np.isfinite(first) else np.inf, recording.file)


def _common_crs(recordings: Sequence[Recording]) -> str:
    filled = [r for r in recordings if len(r.pings)]
    for recording in filled:
        if recording.crs != filled[0].crs:
            raise GeoreferenceError(
                f"{recording.file}: its coordinates are in {recording.crs}, those of {filled[0].file} in"
                f" {filled[0].crs}; bring the files of a survey to one coordinate system"
            )
    return filled[0].crs if filled else projection.GEOGRAPHIC


def _all_pings(recordings: Sequence[Recording]) -> pd.DataFrame:
    tables = [r.pings.assign(file=r.file, source=number) for number, r in enumerate(recordings)]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def _usable(pings: pd.DataFrame, crs: str, skipped: Counter[str]) -> pd.DataFrame:
    """Return the pings to keep, in order of time; their index says where they stood among all that were read."""
    if pings.empty:
        return pings
    pings = _without(pings, ~np.isfinite(pings["time_s"]), "pings without a time", skipped)
    east, north = pings["east"].to_numpy(), pings["north"].to_numpy()
    lost = ~np.isfinite(east + north)
    if crs == projection.GEOGRAPHIC:
        with np.errstate(invalid="ignore"):
            lost |= (np.abs(east) > 180) | (np.abs(north) > 90)
    pings = _without(pings, lost, "pings without a position on the earth", skipped)
    unknown = ~np.isfinite(pings["heading_rad"]) | ~(pings["depth_m"].abs() < _DEEPEST_M)
    pings = _without(pings, unknown, "pings without a heading or depth", skipped)
    pings = pings.iloc[np.argsort(pings["time_s"].to_numpy(), kind="stable")]
    pings = _without(pings, _repeats(pings), "pings at a time that another file has too", skipped)
    return _without(pings, _jumps(pings, crs), "pings far off the track", skipped)


def _without(pings: pd.DataFrame, unusable: np.ndarray, reason: str, skipped: Counter[str]) -> pd.DataFrame:
    if count := int(np.sum(unusable)):
        skipped[reason] += count
    return pings[~np.asarray(unusable)]


def _repeats(pings: pd.DataFrame) -> np.ndarray:
    # within a file, two pings of one time are the two heads of a sonar
    time, source = pings["time_s"].to_numpy(), pings["source"].to_numpy()
    begins = np.diff(time, prepend=-np.inf) > 0
    first = np.maximum.accumulate(np.where(begins, np.arange(len(time)), 0))
    return source != source[first]


def _jumps(pings: pd.DataFrame, crs: str) -> np.ndarray:
    """Return which pings lie farther from the median of five neighbours than any vehicle moves."""
    if len(pings) < 5:
        return np.zeros(len(pings), bool)
    time, east, north = (pings[name].to_numpy() for name in ("time_s", "east", "north"))
    if crs == projection.GEOGRAPHIC:
        east, north = projection.roughly(east, north)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad([time, east, north], ((0, 0), (2, 2)), "reflect"), 5, 1)
    off = np.hypot(east - np.median(windows[1], 1), north - np.median(windows[2], 1))
    return np.asarray(off > _JITTER_M + _FASTEST_M_S * np.ptp(windows[0], 1))


def _ping_table(pings: pd.DataFrame, frame: projection.Frame, origin: tuple[float, float]) -> pd.DataFrame:
    heading = pings["heading_rad"].to_numpy()
    east, north = frame.turned(slice(None), np.sin(heading), np.cos(heading))
    table = pings.assign(ping=np.arange(len(pings), dtype=np.int32), x_m=frame.x - origin[0], y_m=frame.y - origin[1])
    table = table.assign(z_m=-table["depth_m"], yaw_rad=pose.heading_to_yaw(np.arctan2(east, north)))
    return table[PINGS.names].reset_index(drop=True)


def _soundings(
    recordings: Sequence[Recording],
    pings: pd.DataFrame,
    frame: projection.Frame,
    origin: tuple[float, float],
    skipped: Counter[str],
) -> pd.DataFrame:
    read = _all_soundings(recordings, pings.index.to_numpy(), skipped)
    ping, along, across, down = (read[name] for name in ("ping", "along_m", "across_m", "down_m"))
    heading, depth = pings["heading_rad"].to_numpy()[ping], pings["depth_m"].to_numpy()[ping]
    sin, cos = np.sin(heading), np.cos(heading)
    east, north = frame.turned(ping, along * sin + across * cos, along * cos - across * sin)
    read["x_m"] = frame.x[ping] - origin[0] + east
    read["y_m"] = frame.y[ping] - origin[1] + north
    read["z_m"] = -(depth + down)
    beyond = np.hypot(along, across) > _FARTHEST_M
    beyond |= (read["z_m"] < -_DEEPEST_M) | (read["z_m"] > _HIGHEST_M)
    read["quality"][beyond & (read["quality"] == 0)] = IMPOSSIBLE
    return pd.DataFrame({name: read[name] for name in SOUNDINGS.names})


def _all_soundings(recordings: Sequence[Recording], kept: np.ndarray, skipped: Counter[str]) -> dict[str, np.ndarray]:
    """Return the columns of the kept pings' soundings, in order of ping and beam; none stands twice."""
    number = np.full(sum(len(r.pings) for r in recordings), -1, np.int32)
    number[kept] = np.arange(len(kept))
    first = np.cumsum([0, *(len(r.pings) for r in recordings)])
    names = ("beam", "along_m", "across_m", "down_m", "quality")
    table = {name: np.concatenate([r.soundings[name].to_numpy() for r in recordings]) for name in names}
    rows = [number[r.soundings["ping"].to_numpy() + at] for r, at in zip(recordings, first, strict=False)]
    table["ping"] = np.concatenate(rows)
    table["beam"], table["quality"] = table["beam"].astype(np.int32), table["quality"].astype(np.int8)
    numbers = np.isfinite(table["along_m"] + table["across_m"] + table["down_m"])
    table = _select(table, numbers, "soundings without a place", skipped)
    table = _select(table, table["ping"] >= 0, "soundings of skipped pings", skipped)
    table = _ordered(table)
    return _select(table, ~_twice(table), "soundings that stand twice", skipped)


def _select(
    table: dict[str, np.ndarray], good: np.ndarray, reason: str, skipped: Counter[str]
) -> dict[str, np.ndarray]:
    if good.all():
        return table
    skipped[reason] += int(np.sum(~good))
    return {name: column[good] for name, column in table.items()}


def _ordered(table: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    ping, beam = np.diff(table["ping"]), np.diff(table["beam"])
    if np.all((ping > 0) | ((ping == 0) & (beam >= 0))):
        return table
    order = np.lexsort((table["beam"], table["ping"]))
    return {name: column[order] for name, column in table.items()}


def _twice(table: dict[str, np.ndarray]) -> np.ndarray:
    same = np.ones(len(table["ping"]), bool)
    same[:1] = False
    for name in ("ping", "beam", "along_m", "across_m", "down_m"):
        same[1:] &= np.diff(table[name]) == 0
    return same


def _report(
    recordings: Sequence[Recording], pings: int, soundings: pd.DataFrame, skipped: Counter[str]
) -> dict[str, object]:
    problems = [problem for recording in recordings for problem in recording.problems]
    return {
        "files": len(recordings),
        "pings": pings + skipped["unreadable pings"],
        "soundings": sum(len(r.soundings) for r in recordings),
        "valid": int((soundings["quality"] == 0).sum()),
        "skipped": dict(sorted(skipped.items())),
        "problems": problems[:_TOLD] + [f"and {len(problems) - _TOLD} more"] * (len(problems) > _TOLD),
    }


def _nothing(recordings: Sequence[Recording], skipped: Counter[str]) -> str:
    files = recordings[0].file if len(recordings) == 1 else f"{len(recordings)} files"
    told = [f"{count} {reason}" for reason, count in sorted(skipped.items())]
    told += [problem for recording in recordings for problem in recording.problems][:2]
    return f"{files}: holds no usable ping ({'; '.join(told) or 'no ping at all'}); give another file"
