"""SBET navigation, which has no soundings and knows the time of the week, but not the week."""

from pathlib import Path

import numpy as np

from pointnetkl.inspection.facts import Facts
from pointnetkl.inspection.found import Drawing, Found
from pointnetkl.readers import projection, sbet

_DRAWN = 20_000  # records


def look(path: Path, zone: str) -> Found:
    """Return what an SBET file holds; its track is on the map of `zone`, or of the UTM zone where it begins.

    Raises:
        SbetError: no record is credible, or the file cannot be read.
        ProjectionError: the zone does not reach the track.
    """
    held = sbet.read_week(path)
    frame = projection.frame(projection.GEOGRAPHIC, zone, held.east, held.north)
    begin, end = held.time_s[[0, -1]].tolist()
    track = np.column_stack([frame.x, frame.y])
    facts = Facts(
        str(path),
        format="SBET",
        kind="navigation",
        week_s=(begin, end),
        duration_s=end - begin,
        records=len(held.time_s),
        pings=0,
        pings_used=0,
        soundings=0,
        valid=0,
        track_m=float(np.hypot(np.diff(frame.x), np.diff(frame.y)).sum()),
        crs=frame.crs,
        extent_m=(*track.min(axis=0).tolist(), *track.max(axis=0).tolist()),
        longitude_deg=float(held.east[0]),
        latitude_deg=float(held.north[0]),
        skipped={"records that no vehicle can have": held.skipped} if held.skipped else {},
        problems=held.problems,
    )
    return Found(facts, Drawing(track=track[:: -(-len(track) // _DRAWN)]))
