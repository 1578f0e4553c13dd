"""Ties that a user gives, as loop closures: a list of mbnavadjust's, set by hand or by another program."""

from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.correction.products import placed, ties
from pointnetkl.correction.result import CorrectionError
from pointnetkl.correction.solution.belief import Navigation
from pointnetkl.slam.closing import estimate
from pointnetkl.slam.closing.estimate import Closure
from pointnetkl.surveys.se2 import rotate

_NEAR_S = 1.0  # of a file's first or last ping, that a tie may be
_LEAST_M = 1e-3  # standard deviation: a list may say 0


def closures(
    path: Path, crs: str, origin: tuple[float, float], pings: pd.DataFrame, navigation: Navigation
) -> list[Closure]:
    """Return the ties of a list (products.ties) between the submaps nearest to their times; ties of z alone are none.

    Raises:
        TieError: the list is damaged.
        CorrectionError: a tie is of a file that the survey does not have, or of a time that this file does not have.
    """
    listed = [tie for tie in ties.read(path) if tie.status % 4 != ties.Z]
    spans = pings.groupby("file")["time_s"].agg(["min", "max"])
    for file, time in ((Path(f).name, t) for tie in listed for f, t in zip(tie.files, tie.times_s, strict=True)):
        if file not in spans.index:
            raise CorrectionError(f"{path}: has a tie of {file}, which is no file of this survey")
        begin, end = spans.loc[file]
        if not begin - _NEAR_S <= time <= end + _NEAR_S:
            raise CorrectionError(f"{path}: ties {file} at {time:.3f} s, and it is from {begin:.3f} to {end:.3f} s")
    return [_closure(tie, crs, origin, pings, navigation) for tie in listed]


def _closure(
    tie: ties.Tie, crs: str, origin: tuple[float, float], pings: pd.DataFrame, navigation: Navigation
) -> Closure:
    submaps = [int(np.abs(navigation.time_s - time).argmin()) for time in tie.times_s]
    source = max(submaps)
    forward = submaps[-1] == source  # the offset is the second file's against the first's
    targets = [] if tie.is_global else [min(submaps)]
    time = tie.times_s[-1 if forward else 0]
    there = np.array([np.interp(time, pings["time_s"], pings[axis]) for axis in ("x_m", "y_m")])
    to_map = _to_map(crs, there + np.array(origin))
    offset = to_map @ np.array(tie.offset_m[:2]) * (1.0 if forward else -1.0)
    V = to_map @ tie.covariance[:2, :2] @ to_map.T + _LEAST_M**2 * np.eye(2)
    lever = rotate(there - navigation.poses[source, :2], -float(navigation.poses[source, 2]))
    A = np.linalg.inv(np.linalg.cholesky(V))
    return Closure(
        estimate.Tie.at(navigation.poses, source, targets, None if targets else np.empty(0), lever),
        A,
        A @ offset,
        float(np.trace(V)) / 2,
        offset,
    )


def _to_map(crs: str, place: np.ndarray) -> np.ndarray:
    earth = placed.on_earth(crs, place[None])
    return np.eye(2) if earth is None else np.asarray(np.linalg.inv(earth.to_ground[0]))
