"""A survey's own navigation replaced by a better one, post-processed, from files that lie beside the raw ones."""

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
_STRAY = 0.01  # share of a file's pings whose times may be wrong
_APART_M, _DEGREE_M = 10.0, 111_195.0
_NAMED = 3  # of the files, the others are only counted


class NavigationError(SurveyError):
    """Navigation is not that of the survey beside it."""


def known(file: Path) -> bool:
    """Whether a file is navigation: by its content or, so that damage is told, by an extension that no other has."""
    if file.suffix.lower() == ".sbet":
        return True
    try:
        with file.open("rb") as opened:
            return sbet.begins(opened.read(formats.HEAD_BYTES))
    except OSError:
        return False  # who reads it tells why


def replaced(spools: Sequence[Spool], files: Sequence[Path], clock: str) -> list[Spool]:
    """Return raw files with places and attitudes of their pings from SBET `files`, whose clock is gps or utc.

    Pings at other times lose their position. Depths, and along, across and down of soundings, stay the sonar's.
    Tracks are read one after the other: one of a day is some 300 MB.

    Raises:
        NavigationError: the raw files are not in longitude and latitude, have no pings, or of other times or of more
            than a week, or two of the files disagree.
        SbetError: a file is not SBET.
    """
    named = _named(files)
    begin, end = _span(spools, named)
    better = [replace(one, pings=one.pings.assign(**dict.fromkeys(_REPLACED, np.nan))) for one in spools]
    told, reach = [], [np.inf, -np.inf]
    for number, file in enumerate(files):
        track = sbet.read(file, (begin + end) / 2, clock)
        placed = [_placed(one.pings, track) for one in better]
        if (apart := max(apart_m for _, apart_m in placed)) > _APART_M:
            raise NavigationError(
                f"{file}: is {apart:.0f} m away from {_named(files[:number])} at the same times, by the second of the"
                " week; take away what is of another week, or less good"
            )
        better = [replace(one, pings=pings) for one, (pings, _) in zip(better, placed, strict=True)]
        told += track.problems + [f"{track.file}: {track.skipped} records are no vehicle's"] * bool(track.skipped)
        reach = [min(reach[0], track.time_s.min()), max(reach[1], track.time_s.max())]
    if not any(np.isfinite(one.pings["east"]).any() for one in better):
        raise NavigationError(
            f"{named}: has no time within the survey's, {begin:.3f} to {end:.3f} s of {reach[0]:.3f} to"
            f" {reach[1]:.3f} s (UTC since 1970); is ingest.sbet_clock {clock} right?"
        )
    better = [_told(one, named) for one in better]
    return [replace(better[0], problems=[*told, *better[0].problems]), *better[1:]]


def _span(spools: Sequence[Spool], named: str) -> tuple[float, float]:
    """Return the first and the last time of a survey that navigation can be of."""
    if not spools:
        raise NavigationError(f"{named}: is navigation, and no raw files stand beside it; put them there")
    times = [time[np.isfinite(time)] for one in spools if len(time := one.pings["time_s"].to_numpy(np.float64))]
    ends = [np.quantile(time, [_STRAY, 1 - _STRAY]) for time in times if len(time)]
    if not ends:
        raise NavigationError(f"{named}: the raw files beside it have no pings whose navigation it could replace")
    if projected := [one for one in spools if one.crs != projection.GEOGRAPHIC and len(one.pings)]:
        raise NavigationError(
            f"{named}: is in longitude and latitude, and {projected[0].file} in {projected[0].crs}; take it away"
        )
    begin, end = float(np.min(ends)), float(np.max(ends))
    if end - begin >= _WEEK_S:
        raise NavigationError(
            f"{named}: the pings beside it spread over {(end - begin) / 86_400:.1f} days, and SBET does not say of"
            " which week it is; make a survey of each week's files"
        )
    return begin, end


def _placed(pings: pd.DataFrame, track: Navigation) -> tuple[pd.DataFrame, float]:
    """Return pings, those that have no place yet with the track's, and how far in metres it is from others' places."""
    time = pings["time_s"].to_numpy(np.float64)
    if not np.isfinite(time).any():
        return pings, 0.0
    found, _ = sbet.apply(pings, sbet.around(track, float(np.nanmin(time)), float(np.nanmax(time))))
    before = pings.loc[found.index]
    new = before["east"].isna()
    pings = pings.copy()
    pings.loc[found.index[new], _REPLACED] = found.loc[new, _REPLACED]
    return pings, _apart_m(found[~new], before[~new])


def _apart_m(some: pd.DataFrame, others: pd.DataFrame) -> float:
    """Return the largest distance between the places of the same pings, 0 of none."""
    east = np.mod((some["east"] - others["east"]).to_numpy() + 180.0, 360.0) - 180.0
    north = (some["north"] - others["north"]).to_numpy()
    apart = np.hypot(east * np.cos(np.deg2rad(some["north"].to_numpy())), north)
    return float(apart.max(initial=0.0)) * _DEGREE_M


def _told(one: Spool, named: str) -> Spool:
    without = int(one.pings["east"].isna().sum())
    told = [f"{one.file}: {without} pings are at no time of {named}"] if without else []
    return replace(one, problems=[*one.problems, *told])


def _named(files: Sequence[Path]) -> str:
    more = f" and {len(files) - _NAMED} more" if len(files) > _NAMED else ""
    return ", ".join(map(str, files[:_NAMED])) + more
