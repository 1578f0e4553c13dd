"""A survey's own navigation replaced by post-processed navigation, from files in the folder of the raw files."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.readers import formats, projection, sbet
from pointnetkl.readers.sbet import Navigation
from pointnetkl.readers.spool import Spool
from pointnetkl.surveys.survey import SurveyError

_REPLACED = ["east", "north", "roll_rad", "pitch_rad", "heading_rad"]
_WEEK_S = 604_800.0
_STRAY = 0.01  # share of a file's pings, at either end, whose times may be wrong
_APART_M, _DEGREE_M = 10.0, 111_195.0
_NAMED = 3  # files that a message names; it counts the others


class NavigationError(SurveyError):
    """Navigation is not of the survey whose raw files it stands beside."""


def is_navigation(file: Path) -> bool:
    """Whether a file is navigation: by its content, or by its extension, so that damage is reported."""
    if file.suffix.lower() == ".sbet":
        return True
    try:
        with file.open("rb") as opened:
            return sbet.begins(opened.read(formats.HEAD_BYTES))
    except OSError:
        return False  # its reader says why


def replace_navigation(spools: Sequence[Spool], files: Sequence[Path], clock: str) -> list[Spool]:
    """Return raw files whose pings have positions and attitudes of SBET `files`; `clock` is gps or utc.

    Pings at times without navigation lose their position. Depths and soundings stay the sonar's. SBET files are read
    one after the other, because one of a day takes some 300 MB.

    Raises:
        NavigationError: the raw files are not in longitude and latitude, have no pings, pings at other times or over
            more than a week, or two of the SBET files disagree.
        SbetError: a file is not SBET.
    """
    names = _names(files)
    begin, end = _span(spools, names)
    better = [replace(spool, pings=spool.pings.assign(**dict.fromkeys(_REPLACED, np.nan))) for spool in spools]
    sentences, reach = [], [np.inf, -np.inf]
    for number, file in enumerate(files):
        track = sbet.read(file, (begin + end) / 2, clock)
        placed = [_placed(spool.pings, track) for spool in better]
        if (apart := max(apart_m for _, apart_m in placed)) > _APART_M:
            raise NavigationError(
                f"{file}: is {apart:.0f} m away from {_names(files[:number])} at the same times, by the second of the"
                " week; take away what is of another week, or less good"
            )
        better = [replace(spool, pings=pings) for spool, (pings, _) in zip(better, placed, strict=True)]
        sentences += track.problems + [f"{track.file}: {track.skipped} records are no vehicle's"] * bool(track.skipped)
        reach = [min(reach[0], track.time_s.min()), max(reach[1], track.time_s.max())]
    if not any(np.isfinite(spool.pings["east"]).any() for spool in better):
        raise NavigationError(
            f"{names}: has no time within the survey's, {begin:.3f} to {end:.3f} s of {reach[0]:.3f} to"
            f" {reach[1]:.3f} s (UTC since 1970); is ingest.sbet_clock {clock} right?"
        )
    better = [_with_gaps_reported(spool, names) for spool in better]
    return [replace(better[0], problems=[*sentences, *better[0].problems]), *better[1:]]


def _span(spools: Sequence[Spool], names: str) -> tuple[float, float]:
    """Return the first and the last time of a survey, after checking that navigation can be for it."""
    if not spools:
        raise NavigationError(f"{names}: is navigation, and no raw files stand beside it; put them there")
    times = [time[np.isfinite(time)] for spool in spools if len(time := spool.pings["time_s"].to_numpy(np.float64))]
    ends = [np.quantile(time, [_STRAY, 1 - _STRAY]) for time in times if len(time)]
    if not ends:
        raise NavigationError(f"{names}: the raw files beside it have no pings whose navigation it could replace")
    if projected := [spool for spool in spools if spool.crs != projection.GEOGRAPHIC and len(spool.pings)]:
        raise NavigationError(
            f"{names}: is in longitude and latitude, and {projected[0].file} in {projected[0].crs}; take it away"
        )
    begin, end = float(np.min(ends)), float(np.max(ends))
    if end - begin >= _WEEK_S:
        raise NavigationError(
            f"{names}: the pings beside it spread over {(end - begin) / 86_400:.1f} days, and SBET does not say of"
            " which week it is; make a survey of each week's files"
        )
    return begin, end


def _placed(pings: pd.DataFrame, track: Navigation) -> tuple[pd.DataFrame, float]:
    """Return pings, those without a place now with the track's, and the track's largest distance to other places, m."""
    time = pings["time_s"].to_numpy(np.float64)
    if not np.isfinite(time).any():
        return pings, 0.0
    interpolated, _ = sbet.apply(pings, sbet.around(track, float(np.nanmin(time)), float(np.nanmax(time))))
    before = pings.loc[interpolated.index]
    unplaced = before["east"].isna()
    pings = pings.copy()
    pings.loc[interpolated.index[unplaced], _REPLACED] = interpolated.loc[unplaced, _REPLACED]
    return pings, _apart_m(interpolated[~unplaced], before[~unplaced])


def _apart_m(places: pd.DataFrame, others: pd.DataFrame) -> float:
    """Return the largest distance between two places of the same pings; 0 if there are none."""
    east = np.mod((places["east"] - others["east"]).to_numpy() + 180.0, 360.0) - 180.0
    north = (places["north"] - others["north"]).to_numpy()
    apart = np.hypot(east * np.cos(np.deg2rad(places["north"].to_numpy())), north)
    return float(apart.max(initial=0.0)) * _DEGREE_M


def _with_gaps_reported(spool: Spool, names: str) -> Spool:
    lost = int(spool.pings["east"].isna().sum())
    sentences = [f"{spool.file}: {lost} pings are at no time of {names}"] if lost else []
    return replace(spool, problems=[*spool.problems, *sentences])


def _names(files: Sequence[Path]) -> str:
    more = f" and {len(files) - _NAMED} more" if len(files) > _NAMED else ""
    return ", ".join(map(str, files[:_NAMED])) + more
