"""A raw file of soundings, read as stage `ingest` reads it."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from pointnetkl import readers
from pointnetkl.inspection import cells, earth, facts
from pointnetkl.inspection.facts import Drawing, Facts, Inspection
from pointnetkl.inspection.tally import Tally
from pointnetkl.readers import spool
from pointnetkl.readers.formats.recording import Problems
from pointnetkl.readers.georeference import GeoreferenceError, Sink
from pointnetkl.surveys.survey import POINTS, SUBMAPS, SWATHS, Survey, track_length


def inspect(path: Path, settings: readers.Settings) -> Inspection:
    """Read a whole file and return its facts and its drawing.

    A file without pings is no error. If all its pings are damaged or without a place, its facts have an `error`.

    Raises:
        SurveyError: the file is of no known format, or damaged beyond use.
    """
    tally = Tally()
    try:
        with _with_progress(f"placing {path.name}", tally.take) as sink:
            survey = readers.read(path, settings, sink)
    except GeoreferenceError as error:
        return Inspection(_unplaced(path, str(error)))
    return Inspection(_facts(path, survey, tally), _drawing(survey, tally))


@contextlib.contextmanager
def _with_progress(label: str, sink: Sink) -> Iterator[Sink]:
    """Return a sink that also moves a progress bar, from the first part on."""
    bars: list[Any] = []

    def watching(part: pd.DataFrame) -> None:
        if not bars:
            bars.append(tqdm(desc=label, unit=" soundings", unit_scale=True, delay=2.0, leave=False))
        sink(part)
        bars[0].update(len(part))

    try:
        yield watching
    finally:
        for bar in bars:
            bar.close()


def _drawing(survey: Survey, tally: Tally) -> Drawing | None:
    points = tally.points + np.array([*survey.origin, 0.0])
    if not len(points):
        return None
    covered = cells.from_points(points)
    track = survey.pings[["x_m", "y_m"]].to_numpy() + survey.origin if survey.kind == SWATHS else np.empty((0, 2))
    swaths = tally.swaths if survey.kind == SWATHS else None
    return Drawing(points if covered is None else points[:0], covered, track, swaths, survey.pings)


def _facts(path: Path, survey: Survey, tally: Tally) -> Facts:
    report = survey.report
    # unreadable pings are in `skipped` alone, because readers cannot count all of them
    pings = report["pings"] - report["skipped"].get("unreadable pings", 0)
    facts_of_kind = _point_facts if survey.kind == POINTS else _submap_facts if survey.kind == SUBMAPS else _ping_facts
    return Facts(
        str(path),
        format=", ".join(report["formats"]),
        kind=survey.kind,
        sensor=", ".join(report["sensors"]) or None,
        **{"pings": pings, "pings_used": len(survey.pings)} | facts_of_kind(survey, tally),
        soundings=report["soundings"],
        valid=report["valid"],
        flagged={reason: count for reason, count in report["flagged"].items() if count},
        **_depths(report, survey.kind),
        **_place(survey, tally),
        vertical="; ".join(report["vertical"]) or None,
        skipped=report["skipped"],
        problems=report["problems"],
    )


def _ping_facts(survey: Survey, tally: Tally) -> dict[str, Any]:
    start, end = survey.pings["time_s"].iloc[[0, -1]].tolist()
    return {
        "start": facts.moment(start),
        "end": facts.moment(end),
        "duration_s": end - start,
        "beams": tally.beams(len(survey.pings)),
        "track_m": track_length(survey.pings),
        "swath_m": tally.swath_m(),
    }


def _point_facts(survey: Survey, tally: Tally) -> dict[str, Any]:
    covered = cells.from_points(tally.points)
    return {"pings": 0, "pings_used": 0, "area_m2": covered.area_m2 if covered else None}


def _submap_facts(survey: Survey, tally: Tally) -> dict[str, Any]:
    x, y, z, yaw = survey.pings[["x_m", "y_m", "z_m", "yaw_rad"]].iloc[0].tolist()
    pose = {"x_m": x + survey.origin[0], "y_m": y + survey.origin[1], "z_m": z, "yaw_deg": float(np.rad2deg(yaw))}
    return _point_facts(survey, tally) | {"pose": pose}


def _depths(report: dict[str, Any], kind: str) -> dict[str, Any]:
    if "depth_m" not in report:
        return {}
    shallowest, low, high, deepest = report["depth_m"]
    # a surface has been cleaned by its maker, a sonar's pings have not
    shown = (low, high) if kind == SWATHS else (shallowest, deepest)
    return {"depth_min_m": shown[0], "depth_max_m": shown[1], "depth_extremes_m": (shallowest, deepest)}


def _place(survey: Survey, tally: Tally) -> dict[str, Any]:
    place: dict[str, Any] = {"crs": survey.crs}
    if np.isfinite(tally.low).all():
        west, south = (tally.low + survey.origin).tolist()
        east, north = (tally.high + survey.origin).tolist()
        place["extent_m"] = (west, south, east, north)
    return place | earth.place(survey.crs, *survey.origin)


def _unplaced(path: Path, error: str) -> Facts:
    """Return the facts of a file that makes no survey: what was read, and the reason."""
    with tempfile.TemporaryDirectory() as folder:
        raw_file = spool.fill((path, Path(folder) / "soundings"))
    return Facts(
        str(path),
        format=raw_file.format,
        kind=raw_file.kind,
        sensor=raw_file.sensor or None,
        pings=len(raw_file.pings),
        pings_used=0,
        soundings=raw_file.soundings,
        valid=0,
        crs=raw_file.crs,
        vertical=raw_file.vertical or None,
        skipped={reason: count for reason, count in sorted(raw_file.skipped.items()) if count},
        problems=Problems(raw_file.file, raw_file.problems, raw_file.problems_omitted).summary,
        error=error if len(raw_file.pings) or raw_file.soundings or raw_file.skipped.total() else None,
    )
