"""Submaps: pieces of a survey of equal track length, thinned to an even spacing, in frames of their own."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.surveys import pose
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError

WHOLE, FIRST, SECOND = 0, 1, 2  # parts of a submap: all pings, every other ping, the other pings

POINTS = pa.schema(
    [("submap", pa.int32()), ("part", pa.int8())] + [(name, pa.float32()) for name in ("x_m", "y_m", "z_m")]
)
# Poses of submap frames in the map frame, from the navigation at the middle ping, levelled (roll = pitch = 0).
POSES = pa.schema(
    [
        ("submap", pa.int32()),
        ("time_s", pa.float64()),  # of the middle ping
        ("x_m", pa.float64()),
        ("y_m", pa.float64()),
        ("z_m", pa.float64()),
        ("yaw_rad", pa.float64()),
        ("track_m", pa.float64()),
        ("pings", pa.int32()),
        ("soundings", pa.int32()),
        ("line", pa.int32()),  # gaps and turns start a new line
    ]
)


class SubmapError(PointNetKLError):
    """A submap cannot be used."""


@dataclass(frozen=True)
class Sampling:
    """How the points of a survey's submaps came to be: `segment` writes it into the metadata of both tables."""

    kind: str  # of the survey: survey.SWATHS, POINTS or SUBMAPS
    spacing_m: float  # median over submaps of the median distance from a point to its nearest neighbour


@dataclass(frozen=True)
class Submap:
    """A point cloud in its own levelled frame: x along the track, y to port, z up, metres."""

    survey: str
    number: int
    points: np.ndarray  # (n, 3) float64: the registration cloud
    first: np.ndarray  # (n1, 3) the same ground from every other ping
    second: np.ndarray  # (n2, 3) the same ground from the other pings


def from_table(survey: str, points: pd.DataFrame) -> list[Submap]:
    """Return the submaps of a POINTS table, by number.

    Raises:
        SubmapError: a submap has a number below 0, or a coordinate that is not finite.
    """
    return [_submap(survey, int(number), rows) for number, rows in points.groupby("submap", sort=True)]


def read(survey: str, path: Path, number: int) -> Submap:
    """Return one submap of a survey's file of POINTS without reading all of the file.

    Raises:
        SubmapError: the file has no such submap, or the submap is refused as by from_table.
        ArtifactError: the file is missing or damaged.
    """
    rows = artifacts.read_table(path, POINTS, only=[("submap", "==", number)])
    if rows.empty:
        raise SubmapError(f"{path}: has no submap {number}; run dvc repro segment@{survey}")
    return _submap(survey, number, rows)


def stream(survey: str, path: Path) -> Iterator[Submap]:
    """Yield the submaps of a survey's file of POINTS by number, with a few of them in memory at a time.

    Raises:
        SubmapError: the rows are not sorted by submap, or one is refused as by from_table.
        ArtifactError: the file is missing or damaged.
    """
    rest = POINTS.empty_table().to_pandas()
    for group in artifacts.read_groups(path, POINTS):
        rows = pd.concat([rest, group], ignore_index=True)
        if not rows["submap"].is_monotonic_increasing:
            raise SubmapError(f"{path}: its rows are not sorted by submap; run dvc repro segment@{survey}")
        last = rows["submap"] == rows["submap"].max()  # may go on in the next group
        yield from from_table(survey, rows[~last])
        rest = rows[last]
    yield from from_table(survey, rest)


def to_table(submaps: Iterable[Submap]) -> pd.DataFrame:
    """Return submaps as a POINTS table."""
    parts = [
        pd.DataFrame({"submap": s.number, "part": part, "x_m": p[:, 0], "y_m": p[:, 1], "z_m": p[:, 2]})
        for s in submaps
        for part, p in ((WHOLE, s.points), (FIRST, s.first), (SECOND, s.second))
    ]
    return pd.concat(parts, ignore_index=True) if parts else POINTS.empty_table().to_pandas()


def read_sampling(path: Path) -> Sampling:
    """Return the sampling that is written with a table of POINTS or POSES.

    Raises:
        SubmapError: the table has none, or one that makes no sense.
        ArtifactError: the file is missing or damaged.
    """
    metadata = artifacts.table_metadata(path)
    try:
        sampling = Sampling(str(metadata["kind"]), float(metadata["spacing_m"]))
    except (KeyError, TypeError, ValueError) as error:
        raise SubmapError(f"{path}: does not say its survey's kind and spacing_m; run dvc repro segment") from error
    if not 0 < sampling.spacing_m < np.inf:
        raise SubmapError(
            f"{path}: its spacing_m is {sampling.spacing_m:g}, must be a number above zero; run dvc repro segment"
        )
    return sampling


def poses_from_table(table: pd.DataFrame) -> np.ndarray:
    """Return T_map_submap (n, 4, 4) of a table with columns x_m, y_m, z_m and yaw_rad, in the order of its rows."""
    rows = table[["x_m", "y_m", "z_m", "yaw_rad"]].to_numpy(np.float64)
    return np.array([pose.matrix(row[:3], row[3]) for row in rows]).reshape(-1, 4, 4)


def _submap(survey: str, number: int, rows: pd.DataFrame) -> Submap:
    if number < 0:
        raise SubmapError(f"{survey}: submap {number} has a number below 0; run dvc repro segment@{survey}")
    xyz, part = rows[["x_m", "y_m", "z_m"]].to_numpy(np.float64), rows["part"].to_numpy()
    if not np.isfinite(xyz).all():
        raise SubmapError(f"{survey}: submap {number} has a point that is not finite; run dvc repro segment@{survey}")
    return Submap(survey, number, xyz[part == WHOLE], xyz[part == FIRST], xyz[part == SECOND])
