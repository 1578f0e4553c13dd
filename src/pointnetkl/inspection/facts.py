"""Facts of a raw file, None where a fact is unknown, and the data of its plots."""

import dataclasses
import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.inspection.cells import Cells

_DECIMALS = {"_m": 3, "_m2": 0, "_deg": 7, "_s": 3}  # by a name's ending: finer than any measurement


@dataclass(frozen=True)
class Facts:
    """A file as `inspect` prints it; names and order of the fields are those of its JSON."""

    file: str
    format: str | None = None
    kind: str | None = None  # pings, points, submaps, grid, navigation
    sensor: str | None = None
    start: str | None = None  # ISO 8601, UTC
    end: str | None = None
    week_s: tuple[float, float] | None = None  # start and end in seconds of the week, if the file has no date
    duration_s: float | None = None
    records: int | None = None  # of navigation
    pings: int | None = None  # that could be read
    pings_used: int | None = None  # those with a time and a place
    beams: dict[str, int] | None = None  # per ping: min, median, max
    soundings: int | None = None
    valid: int | None = None
    flagged: dict[str, int] = field(default_factory=dict)  # soundings that are not valid, by reason
    track_m: float | None = None
    swath_m: float | None = None  # median over the pings
    area_m2: float | None = None  # of the cells with soundings
    cell_m: float | None = None  # of a grid
    depth_min_m: float | None = None  # of pings the quantile of 1 %, because single wrong soundings would set the range
    depth_max_m: float | None = None  # of pings the quantile of 99 %
    depth_extremes_m: tuple[float, float] | None = None  # of all valid soundings
    crs: str | None = None
    extent_m: tuple[float, float, float, float] | None = None  # west, south, east, north of the valid soundings, in crs
    longitude_deg: float | None = None  # of the first position
    latitude_deg: float | None = None
    pose: dict[str, float] | None = None  # of a submap
    vertical: str | None = None
    skipped: dict[str, int] = field(default_factory=dict)  # counts by reason
    problems: list[str] = field(default_factory=list)
    error: str | None = None  # why it cannot be used
    plots: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Return the fields for JSON, without `error` and `plots` if they are empty."""
        content = {name: _rounded(name, value) for name, value in dataclasses.asdict(self).items()}
        return {name: value for name, value in content.items() if value or name not in ("error", "plots")}


@dataclass(frozen=True)
class Drawing:
    """The data of a file's plots, in metres of its CRS."""

    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))  # z up; empty if there are cells
    cells: Cells | None = None
    track: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    swaths: pd.DataFrame | None = None  # valid soundings of some pings, columns as survey.SOUNDINGS
    pings: pd.DataFrame | None = None  # survey.PINGS

    @property
    def places(self) -> np.ndarray:
        """Places (n, 2) that a map must include."""
        corners = [] if self.cells is None else [np.reshape(self.cells.extent, (2, 2)).T]
        return np.concatenate([self.points[:, :2], self.track, *corners])


@dataclass(frozen=True)
class Inspection:
    """A file's facts, and the data of its plots if there is something to draw."""

    facts: Facts
    drawing: Drawing | None = None


def moment(time_s: float) -> str | None:
    """Return a time, seconds since 1970, as ISO 8601 in UTC; None if it is in no year of the calendar."""
    try:
        return datetime.fromtimestamp(round(time_s, 3), UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    except (ValueError, OverflowError, OSError):  # the error depends on the platform
        return None


def _rounded(name: str, value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(key, inner) for key, inner in value.items()}
    if isinstance(value, tuple):
        return [_rounded(name, inner) for inner in value]
    if not isinstance(value, float):
        return value
    decimals = _DECIMALS.get(f"_{name.rpartition('_')[2]}", 6)
    return round(value, decimals) if math.isfinite(value) else None
