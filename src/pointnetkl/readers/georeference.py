"""Raw files, with soundings relative to the vehicle, become a survey in one map frame."""

import functools
import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pandas as pd

from pointnetkl.readers import arrangement, cleaning, projection, spool
from pointnetkl.readers.arrangement import DEEPEST_M
from pointnetkl.readers.formats.recording import IMPOSSIBLE, OUTLIER, PART, Problems
from pointnetkl.readers.spool import POINT_PLACE, SWATH_PLACE, Spool
from pointnetkl.readers.tally import FLAGS, Tally
from pointnetkl.surveys import pose
from pointnetkl.surveys.survey import PINGS, POINTS, SOUNDINGS, SUBMAPS, SWATHS, Survey, SurveyError

Sink = Callable[[pd.DataFrame], None]  # is called with each part of a survey's soundings (survey.SOUNDINGS)
Columns = dict[str, np.ndarray]

_SHALLOWEST_M, _HIGHEST_M = 100.0, 9_000.0  # highest z of a seabed that a ship sounds, and of any ground
_FARTHEST_M = 30_000.0  # from the sonar
_WIDEST_M = 1e6  # extent of a survey: no map projection is good enough beyond


class GeoreferenceError(SurveyError):
    """Raw files do not make a survey: nothing in them is usable, or they lie too far apart."""


def survey(spools: Sequence[Spool], zone: str, sink: Sink, outliers: cleaning.Settings = cleaning.NONE) -> Survey:
    """Join files in the order of time, and hand their soundings to `sink`, a part (survey.SOUNDINGS) at a time.

    The parts are in order of ping and beam. `zone` is the CRS for longitudes and latitudes, or "auto". Soundings of
    swaths that disagree with their neighbours, by the settings `outliers`, are flagged.

    Raises:
        GeoreferenceError: nothing is usable, or the zone does not reach all positions or is no map in metres.
        ArrangementError: the files are of different kinds or have different coordinate systems.
    """
    spools = arrangement.in_time_order(spools)
    kind, crs = arrangement.common(spools)
    skipped = sum((s.skipped for s in spools), Counter[str]())
    tally = Tally(skipped, _SHALLOWEST_M if kind == SWATHS else _HIGHEST_M)
    if kind == POINTS:
        return _surface(spools, crs, zone, sink, tally)
    pings = arrangement.usable(spools, crs, kind, tally.skipped)
    if pings.empty:
        raise GeoreferenceError(_nothing(spools, tally.skipped))
    frame = _framed(sorted(set(pings["file"])), crs, zone, pings["east"].to_numpy(), pings["north"].to_numpy())
    origin = _origin(frame)
    if (extent := float(np.max(np.hypot(frame.x - origin[0], frame.y - origin[1])))) > _WIDEST_M:
        raise GeoreferenceError(
            f"{', '.join(sorted(set(pings['file']))[:5])}: pings lie {extent / 1000:.0f} km apart; read what is far"
            " away as surveys of their own"
        )
    placed = functools.partial(_placed, spools, pings, frame, origin, tally.highest_m)
    for rows in _batches(pings["count"].to_numpy()):
        part = placed(rows, tally.skipped)
        if kind != SUBMAPS and outliers.sigmas > 0:
            before, after = (placed(beside, Counter()) for beside in _beside(rows, len(pings)))
            _clean(part, before, after, outliers)
        tally.add(part["z_m"], part["quality"])
        sink(pd.DataFrame({name: part[name] for name in SOUNDINGS.names}))
    return Survey(_ping_table(pings, frame, origin), frame.crs, origin, kind, _report(spools, tally))


def _framed(files: Sequence[str], crs: str, zone: str, east: np.ndarray, north: np.ndarray) -> projection.Frame:
    try:
        return projection.frame(crs, zone, east, north)
    except projection.ProjectionError as error:
        raise GeoreferenceError(f"{', '.join(files[:5])}: {error}") from error


def _origin(frame: projection.Frame) -> tuple[float, float]:
    return float(np.round(frame.x[0])), float(np.round(frame.y[0]))


def _batches(count: np.ndarray) -> Iterator[slice]:
    """Return consecutive runs of pings with about PART soundings each."""
    group = (np.cumsum(count) - count) // PART
    edges = [0, *(1 + np.flatnonzero(np.diff(group))).tolist(), len(count)]
    return (slice(*edge) for edge in itertools.pairwise(edges))


def _beside(rows: slice, count: int) -> tuple[slice, slice]:
    """Return the pings before and after `rows`, of `count` in all, that the outlier filter compares with."""
    before, after = max(0, rows.start - cleaning.PINGS), min(count, rows.stop + cleaning.PINGS)
    return slice(before, rows.start), slice(rows.stop, after)


def _ping_table(pings: pd.DataFrame, frame: projection.Frame, origin: tuple[float, float]) -> pd.DataFrame:
    heading = pings["heading_rad"].to_numpy()
    east, north = frame.turned(slice(None), np.sin(heading), np.cos(heading))
    table = pings.assign(ping=np.arange(len(pings), dtype=np.int32), x_m=frame.x - origin[0], y_m=frame.y - origin[1])
    table = table.assign(z_m=-table["depth_m"], yaw_rad=pose.heading_to_yaw(np.arctan2(east, north)))
    return table[PINGS.names]


def _placed(
    spools: Sequence[Spool],
    pings: pd.DataFrame,
    frame: projection.Frame,
    origin: tuple[float, float],
    highest_m: float,
    rows: slice,
    skipped: Counter[str],
) -> Columns:
    """Return the columns of the pings' soundings on the map, in order of ping and beam, each sounding once."""
    read = _read(spools, pings, rows, skipped)
    ping, along, across, down = (read[name] for name in ("ping", *SWATH_PLACE))
    heading, depth = pings["heading_rad"].to_numpy()[ping], pings["depth_m"].to_numpy()[ping]
    sin, cos = np.sin(heading), np.cos(heading)
    east, north = frame.turned(ping, along * sin + across * cos, along * cos - across * sin)
    read["x_m"] = frame.x[ping] - origin[0] + east
    read["y_m"] = frame.y[ping] - origin[1] + north
    read["z_m"] = -(depth + down)
    beyond = np.hypot(along, across) > _FARTHEST_M
    _flag(read, beyond, highest_m)
    return read


def _flag(table: Columns, beyond: np.ndarray, highest_m: float) -> None:
    beyond = beyond | (table["z_m"] < -DEEPEST_M) | (table["z_m"] > highest_m)
    table["quality"][beyond & (table["quality"] == 0)] = IMPOSSIBLE


def _clean(table: Columns, before: Columns, after: Columns, settings: cleaning.Settings) -> None:
    """Flag outliers; with the pings before and after, so that the result does not depend on batches."""
    tables = (before, table, after)
    good = [np.flatnonzero(columns["quality"] == 0) for columns in tables]
    ping, across, down = (
        np.concatenate([columns[name][rows] for columns, rows in zip(tables, good, strict=True)])
        for name in ("ping", "across_m", "down_m")
    )
    wrong = cleaning.outlying(ping, across, down, settings)[len(good[0]) :][: len(good[1])]
    table["quality"][good[1][wrong]] = OUTLIER


def _read(spools: Sequence[Spool], pings: pd.DataFrame, rows: slice, skipped: Counter[str]) -> Columns:
    source, first, count = (pings[name].to_numpy()[rows] for name in ("source", "first", "count"))
    records = spool.gather(spools, source, first, count)
    table = {name: records[name].copy() for name in records.dtype.names or ()}
    table["ping"] = np.repeat(np.arange(rows.start, rows.stop, dtype=np.int32), count)
    table = _ordered(_finite(table, SWATH_PLACE, skipped))
    return _select(table, ~_duplicates(table), "soundings that stand twice", skipped)


def _finite(table: Columns, place: Sequence[str], skipped: Counter[str]) -> Columns:
    first, second, third = (table[name] for name in place)
    return _select(table, np.isfinite(first + second + third), "soundings without a place", skipped)


def _select(table: Columns, good: np.ndarray, reason: str, skipped: Counter[str]) -> Columns:
    if good.all():
        return table
    skipped[reason] += int(np.sum(~good))
    return {name: column[good] for name, column in table.items()}


def _ordered(table: Columns) -> Columns:
    ping, beam = np.diff(table["ping"]), np.diff(table["beam"])
    if np.all((ping > 0) | ((ping == 0) & (beam >= 0))):
        return table
    order = np.lexsort((table["beam"], table["ping"]))
    return {name: column[order] for name, column in table.items()}


def _duplicates(table: Columns) -> np.ndarray:
    """Return which soundings of an ordered table are equal to the one before."""
    same = np.ones(len(table["ping"]), bool)
    same[:1] = False
    for name in ("ping", "beam", *SWATH_PLACE):
        same[1:] &= np.diff(table[name]) == 0
    return same


def _surface(spools: Sequence[Spool], crs: str, zone: str, sink: Sink, tally: Tally) -> Survey:
    """Put points without pings on the map, in the order of the files; their ping is -1."""
    origin, placed = (0.0, 0.0), 0
    for number, source in enumerate(spools):
        for begin in range(0, source.soundings, PART):
            count = min(PART, source.soundings - begin)
            records = spool.gather(spools, np.array([number]), np.array([begin]), np.array([count]))
            columns = {name: records[name].copy() for name in records.dtype.names or ()}
            table = _finite(columns, POINT_PLACE, tally.skipped)
            if not len(table["up_m"]):
                continue
            frame = _framed([source.file], crs, zone, table["east"], table["north"])
            if not placed:
                origin, zone = _origin(frame), frame.crs if crs == projection.GEOGRAPHIC else zone
            table |= {"x_m": frame.x - origin[0], "y_m": frame.y - origin[1], "z_m": table["up_m"]}
            table |= {"ping": np.full(len(frame.x), -1, np.int32)}
            _flag(table, np.hypot(table["x_m"], table["y_m"]) > _WIDEST_M, tally.highest_m)
            tally.add(table["z_m"], table["quality"])
            placed += len(frame.x)
            sink(pd.DataFrame({name: table[name] for name in SOUNDINGS.names}))
    if not placed:
        raise GeoreferenceError(_nothing(spools, tally.skipped))
    crs = zone if crs == projection.GEOGRAPHIC else crs
    return Survey(PINGS.empty_table().to_pandas(), crs, origin, POINTS, _report(spools, tally))


def _report(spools: Sequence[Spool], tally: Tally) -> dict[str, object]:
    problems = Problems()
    for source in spools:
        problems.extend(source.problems, source.problems_omitted)
    report: dict[str, object] = {
        "files": len(spools),
        "formats": sorted({source.format for source in spools}),
        "sensors": sorted({source.sensor for source in spools} - {""}),
        "vertical": sorted({source.vertical for source in spools} - {""}),
        "pings": sum(len(source.pings) for source in spools) + tally.skipped["unreadable pings"],
        "soundings": sum(source.soundings for source in spools),
        "valid": tally.valid,
        "reordered": arrangement.reordered(spools),
        "flagged": {flag: tally.flagged[flag] for flag in FLAGS},
        "skipped": {reason: count for reason, count in sorted(tally.skipped.items()) if count},
        "problems": problems.summary,
    }
    if tally.valid:
        report["depth_m"] = [tally.shallowest_m, tally.quantile(0.01), tally.quantile(0.99), tally.deepest_m]
    return report


def _nothing(spools: Sequence[Spool], skipped: Counter[str]) -> str:
    files = spools[0].file if len(spools) == 1 else f"{len(spools)} files"
    reasons = [f"{count} {reason}" for reason, count in sorted(skipped.items()) if count]
    reasons += [problem for source in spools for problem in source.problems][:2]
    return f"{files}: holds no usable ping ({'; '.join(reasons) or 'no ping at all'}); give another file"
