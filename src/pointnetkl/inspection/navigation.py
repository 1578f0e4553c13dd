"""SBET navigation, which has no soundings, and times of an unknown week."""

from pathlib import Path

import numpy as np

from pointnetkl.inspection.facts import Drawing, Facts, Inspection
from pointnetkl.readers import projection, sbet

_DRAWN = 20_000  # records


def inspect(path: Path, zone: str) -> Inspection:
    """Return the facts and the drawing of an SBET file; its track is in the CRS `zone`, or in its first UTM zone.

    Raises:
        SbetError: no record is credible, or the file cannot be read.
        ProjectionError: the zone does not reach the track.
    """
    samples = sbet.read_week(path)
    frame = projection.frame(projection.GEOGRAPHIC, zone, samples.east, samples.north)
    begin, end = samples.time_s[[0, -1]].tolist()
    track = np.column_stack([frame.x, frame.y])
    facts = Facts(
        str(path),
        format="SBET",
        kind="navigation",
        week_s=(begin, end),
        duration_s=end - begin,
        records=len(samples.time_s),
        pings=0,
        pings_used=0,
        soundings=0,
        valid=0,
        track_m=float(np.hypot(np.diff(frame.x), np.diff(frame.y)).sum()),
        crs=frame.crs,
        extent_m=(*track.min(axis=0).tolist(), *track.max(axis=0).tolist()),
        longitude_deg=float(samples.east[0]),
        latitude_deg=float(samples.north[0]),
        skipped={"records that no vehicle can have": samples.skipped} if samples.skipped else {},
        problems=samples.problems,
    )
    return Inspection(facts, Drawing(track=track[:: -(-len(track) // _DRAWN)]))
