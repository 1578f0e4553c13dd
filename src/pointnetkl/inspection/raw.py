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
from pointnetkl.inspection.facts import Facts
from pointnetkl.inspection.found import Drawing, Found
from pointnetkl.inspection.tally import Tally
from pointnetkl.readers import spool
from pointnetkl.readers.formats.recording import Problems
from pointnetkl.readers.georeference import GeoreferenceError, Take
from pointnetkl.surveys import survey
from pointnetkl.surveys.survey import POINTS, SUBMAPS, SWATHS, Survey


def look(path: Path, how: readers.Settings) -> Found:
    """Read a file whole and return what it holds.

    A file without pings is no error; one whose pings all are damaged or have no place is, told among its facts.

    Raises:
        SurveyError: the file is of no known format, or damaged beyond use.
    """
    counted = Tally()
    try:
        with _watched(f"placing {path.name}", counted.take) as take:
            found = readers.read(path, how, take)
    except GeoreferenceError as error:
        return Found(_unplaced(path, str(error)))
    return Found(_facts(path, found, counted), _drawing(found, counted))


@contextlib.contextmanager
def _watched(doing: str, take: Take) -> Iterator[Take]:
    """Put a progress bar before what takes the parts, from the first part on."""
    bars: list[Any] = []

    def watching(part: pd.DataFrame) -> None:
        if not bars:
            bars.append(tqdm(desc=doing, unit=" soundings", unit_scale=True, delay=2.0, leave=False))
        take(part)
        bars[0].update(len(part))

    try:
        yield watching
    finally:
        for bar in bars:
            bar.close()


def _drawing(found: Survey, counted: Tally) -> Drawing | None:
    points = counted.points + np.array([*found.origin, 0.0])
    if not len(points):
        return None
    covered = cells.of(points)
    track = found.pings[["x_m", "y_m"]].to_numpy() + found.origin if found.kind == SWATHS else np.empty((0, 2))
    swaths = counted.swaths if found.kind == SWATHS else None
    return Drawing(points if covered is None else points[:0], covered, track, swaths, found.pings)


def _facts(path: Path, found: Survey, counted: Tally) -> Facts:
    report = found.report
    # pings of which nothing could be read stand in `skipped` alone, as those do that no reader could even count
    pings = report["pings"] - report["skipped"].get("unreadable pings", 0)
    of_kind = _of_points if found.kind == POINTS else _of_submap if found.kind == SUBMAPS else _of_pings
    return Facts(
        str(path),
        format=", ".join(report["formats"]),
        kind=found.kind,
        sensor=", ".join(report["sensors"]) or None,
        **{"pings": pings, "pings_used": len(found.pings)} | of_kind(found, counted),
        soundings=report["soundings"],
        valid=report["valid"],
        flagged={reason: count for reason, count in report["flagged"].items() if count},
        **_depths(report, found.kind),
        **_where(found, counted),
        vertical="; ".join(report["vertical"]) or None,
        skipped=report["skipped"],
        problems=report["problems"],
    )


def _of_pings(found: Survey, counted: Tally) -> dict[str, Any]:
    start, end = found.pings["time_s"].iloc[[0, -1]].tolist()
    return {
        "start": facts.moment(start),
        "end": facts.moment(end),
        "duration_s": end - start,
        "beams": counted.beams(len(found.pings)),
        "track_m": survey.track_length(found.pings),
        "swath_m": counted.swath_m(),
    }


def _of_points(found: Survey, counted: Tally) -> dict[str, Any]:
    covered = cells.of(counted.points)
    return {"pings": 0, "pings_used": 0, "area_m2": covered.area_m2 if covered else None}


def _of_submap(found: Survey, counted: Tally) -> dict[str, Any]:
    x, y, z, yaw = found.pings[["x_m", "y_m", "z_m", "yaw_rad"]].iloc[0].tolist()
    pose = {"x_m": x + found.origin[0], "y_m": y + found.origin[1], "z_m": z, "yaw_deg": float(np.rad2deg(yaw))}
    return _of_points(found, counted) | {"pose": pose}


def _depths(report: dict[str, Any], kind: str) -> dict[str, Any]:
    if "depth_m" not in report:
        return {}
    least, low, high, most = report["depth_m"]
    # a surface has been cleaned by whoever made it, a sonar's pings have not
    shown = (low, high) if kind == SWATHS else (least, most)
    return {"depth_min_m": shown[0], "depth_max_m": shown[1], "depth_extremes_m": (least, most)}


def _where(found: Survey, counted: Tally) -> dict[str, Any]:
    place: dict[str, Any] = {"crs": found.crs}
    if np.isfinite(counted.low).all():
        west, south = (counted.low + found.origin).tolist()
        east, north = (counted.high + found.origin).tolist()
        place["extent_m"] = (west, south, east, north)
    return place | earth.place(found.crs, *found.origin)


def _unplaced(path: Path, told: str) -> Facts:
    """Return the facts of a file that makes no survey: what was read of it, and why it is of no use."""
    with tempfile.TemporaryDirectory() as folder:
        held = spool.fill((path, Path(folder) / "soundings"))
    return Facts(
        str(path),
        format=held.format,
        kind=held.kind,
        sensor=held.sensor or None,
        pings=len(held.pings),
        pings_used=0,
        soundings=held.soundings,
        valid=0,
        crs=held.crs,
        vertical=held.vertical or None,
        skipped={reason: count for reason, count in sorted(held.skipped.items()) if count},
        problems=Problems(held.file, held.problems, held.untold).sentences,
        error=told if len(held.pings) or held.soundings or held.skipped.total() else None,
    )
