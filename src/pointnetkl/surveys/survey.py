"""A survey: every raw format is read into this form, and every stage after ingest starts from it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.workflow.errors import PointNetKLError

# Poses are those of the vehicle's navigation, in the map frame: local east, north, up, metres. Yaw is
# counter-clockwise from east, roll and pitch as recorded; z is negative below the sea surface.
PINGS = pa.schema(
    [
        ("ping", pa.int32()),
        ("time_s", pa.float64()),  # UTC, seconds since 1970
        ("x_m", pa.float64()),
        ("y_m", pa.float64()),
        ("z_m", pa.float64()),
        ("roll_rad", pa.float64()),
        ("pitch_rad", pa.float64()),
        ("yaw_rad", pa.float64()),
        ("file", pa.string()),
    ]
)
SOUNDINGS = pa.schema(
    [
        ("ping", pa.int32()),
        ("beam", pa.int32()),
        ("x_m", pa.float64()),
        ("y_m", pa.float64()),
        ("z_m", pa.float64()),
        ("quality", pa.int8()),  # 0: good; else rejected by the sonar, its operator or our cleaning
    ]
)
# The true trajectory, where it is known: in the same frame and angles, at its own times.
TRAJECTORY = pa.schema([(name, pa.float64()) for name in ("time_s", "x_m", "y_m", "z_m", "yaw_rad")])

# Kinds of surveys: swaths of a sonar; a surface without pings; submaps that another program has cut and posed.
SWATHS, POINTS, SUBMAPS = "pings", "points", "submaps"


class SurveyError(PointNetKLError):
    """A survey cannot be read or used."""


@dataclass(frozen=True)
class Survey:
    """Pings in a local map frame and the frame's place on the earth; the many soundings are kept apart."""

    pings: pd.DataFrame  # schema PINGS, sorted by time, numbered from 0
    crs: str  # projected CRS of the map frame, e.g. EPSG:32633; "local" where the data have none
    origin: tuple[float, float]  # easting, northing of the map frame's origin in that CRS, metres
    kind: str  # SWATHS; POINTS, which have no pings; or SUBMAPS, each a ping
    report: dict[str, Any] = field(default_factory=dict)  # counts read, and skipped with the reason


def track_length(pings: pd.DataFrame) -> float:
    """Return the length of the track through the pings, in metres (horizontal)."""
    return float(np.hypot(np.diff(pings["x_m"]), np.diff(pings["y_m"])).sum())


def summary(survey: Survey) -> str:
    """Return a line on what the survey holds and what was skipped, and one more line for each damage."""
    report = survey.report
    # from the 1st to the 99th percentile, because a single wrong sounding would set the range
    depths = "depth {1:.2f} to {2:.2f} m".format(*report["depth_m"]) if "depth_m" in report else "no depth"
    skipped = ", ".join(f"{count} {reason}" for reason, count in report["skipped"].items())
    damage = "".join(f"\n  {problem}" for problem in report["problems"])
    length = track_length(survey.pings)
    track = f" track {length:,.0f} m," if length >= 100 else f" track {length:.1f} m," if len(survey.pings) else ""
    return (
        f"{len(survey.pings)} pings, {report['soundings']} soundings, {report['valid']} valid,{track}"
        f" {depths}, {survey.crs}; skipped: {skipped or 'nothing'}{damage}"
    )
