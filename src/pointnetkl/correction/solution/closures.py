"""The table of loop closures, and the file in which a killed run keeps them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.correction.result import CLOSURES
from pointnetkl.correction.solution import verdict
from pointnetkl.slam.closing.estimate import Closure, Tie
from pointnetkl.slam.closing.schemas import State
from pointnetkl.slam.closing.survey import Closed, Found
from pointnetkl.surveys.se2 import rotate
from pointnetkl.workflow import artifacts

_REFERENCE = -1  # as a target: ground that is not the survey's
_EACH = ("lever", "tied_source", "end", "residual_variance", "points")  # of a closure, as arrays of a file


def table(
    closed: Closed, poses: np.ndarray, time_s: np.ndarray, spacing_m: float, applied: bool = True
) -> pd.DataFrame:
    """Return the closures of a survey (result.CLOSURES), whose submaps' middles are at these poses (n, 3) and times.

    Where they are not applied their weights are 0.
    """
    accepted = [f for f in closed.found if f.state == State.ACCEPTED]
    left = verdict.left_out(closed.navigation, closed.accepted)
    left_out = {id(f): one.after for f, one in zip(accepted, left, strict=True)}
    rows = [_row(f, closed, poses, time_s, spacing_m, left_out.get(id(f))) for f in closed.found]
    table = pd.DataFrame(rows, columns=CLOSURES.names)
    table["weight"] *= float(applied)
    return table.astype({"source": np.int32, "target": np.int32, "rank": np.int32})


def _row(
    f: Found, closed: Closed, poses: np.ndarray, time_s: np.ndarray, spacing_m: float, left_out: np.ndarray | None
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "source": f.source,
        "target": f.targets[0] if f.targets else _REFERENCE,
        "targets": " ".join(map(str, f.targets)),
        "time_s": time_s[f.source],
        "rank": 0,
        "weight": float(f.state == State.ACCEPTED),
        "state": str(f.state),
        **dict(zip(("x_m", "y_m"), poses[f.source, :2].tolist(), strict=True)),
    }
    if f.closure is not None:
        row |= _matched(f.closure, closed, poses, spacing_m)
    if f.closure is not None and left_out is not None:
        row["left_out_m"] = float(np.linalg.norm(np.linalg.pinv(f.closure.A) @ left_out))
    return row | {"target_time_s": time_s[row["target"]] if row["target"] >= 0 else np.nan}


def _matched(closure: Closure, closed: Closed, poses: np.ndarray, spacing_m: float) -> dict[str, Any]:
    tie, before = closure.tie, closed.navigation.poses
    x, y, yaw = poses[tie.source]
    middle = np.array([x, y]) + rotate(tie.lever, yaw)
    shift = closure.end - tie.offset(before)
    largest = tie.targets[int(np.argmax(tie.shares))] if len(tie.targets) else _REFERENCE
    row = {"target": largest, "x_m": middle[0], "y_m": middle[1], "overlap_m2": closure.points * spacing_m**2}
    row |= {"shift_x_m": shift[0], "shift_y_m": shift[1], "rank": closure.rank}
    row |= {"residual_m": float(np.sqrt(closure.residual_variance))}
    if closure.rank == 2:
        V = np.linalg.inv(closure.A.T @ closure.A)
        row |= {"v_xx_m2": V[0, 0], "v_xy_m2": V[0, 1], "v_yy_m2": V[1, 1]}
    if closure.rank:
        residuals = (closure.residual(poses) for poses in (before, closed.estimate.poses))
        row |= dict(zip(("sigmas_before", "sigmas_after"), map(float, map(np.linalg.norm, residuals)), strict=True))
    return row


def save(path: Path, found: Sequence[Found], metadata: Mapping[str, Any]) -> None:
    """Write closures to a file, with their states and whatever else is to be kept."""
    matched = [f.closure for f in found if f.closure is not None]
    ranks = [closure.rank for closure in matched]
    arrays = {
        "source": np.array([f.source for f in found], np.int64),
        "state": np.array([str(f.state) for f in found], "U16"),
        "targets": np.array([k for f in found for k in f.targets], np.int64),
        "count": np.array([len(f.targets) for f in found], np.int64),
        "matched": np.array([f.closure is not None for f in found], bool),
        "rank": np.array(ranks, np.int64),
        "A": np.concatenate([np.empty((0, 2)), *(closure.A for closure in matched)]),
        "c": np.concatenate([np.empty(0), *(closure.c for closure in matched)]),
        "shares": np.concatenate([np.empty(0), *(closure.tie.shares for closure in matched)]),
        "tied": np.concatenate([np.empty((0, 3)), *(closure.tie.tied for closure in matched)]),
    }
    for name in _EACH:
        values = [getattr(closure.tie if hasattr(closure.tie, name) else closure, name) for closure in matched]
        arrays[name] = np.array(values)
    artifacts.write_arrays(path, arrays, metadata)


def load(path: Path) -> tuple[list[Found], dict[str, Any]]:
    """Return what `save` has written."""
    arrays, metadata = artifacts.read_arrays(path)
    targets = np.split(arrays["targets"], np.cumsum(arrays["count"]))[:-1]
    ties = arrays["count"][arrays["matched"]]
    rows, places = np.cumsum(arrays["rank"]), np.cumsum(ties)
    found, k = [], 0
    for source, state, on, matched in zip(
        arrays["source"].tolist(), arrays["state"].tolist(), targets, arrays["matched"].tolist(), strict=True
    ):
        closure = None
        if matched:
            own = slice(rows[k] - arrays["rank"][k], rows[k])
            among = slice(places[k] - ties[k], places[k])
            lever, at, end, variance, points = (arrays[name][k] for name in _EACH)
            tie = Tie(source, on.tolist(), arrays["shares"][among], lever, arrays["tied"][among], at)
            closure = Closure(tie, arrays["A"][own], arrays["c"][own], float(variance), end, int(points))
            k += 1
        found.append(Found(source, on.tolist(), closure, State(state)))
    return found, metadata
