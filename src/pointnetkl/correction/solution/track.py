"""The correction at every ping, continuous along the track, with its sigma.

Drift is a Gaussian process, so what closures say of submaps says what the correction is at any other time: with C_ts
its covariance of a time t with the submaps, J the closures' slopes and S = J C_ss J^T + I,

    correction(t) = -C_ts J^T S^-1 (r + J (x0 - x)),    variance(t) = C_tt - C_ts J^T S^-1 J C_st.

It is taken at knots, a few a submap and at both ends of every line, and is linear in time between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import linalg

from pointnetkl.correction.result import TRACK
from pointnetkl.correction.solution.belief import Navigation
from pointnetkl.slam.closing import drift
from pointnetkl.slam.closing.estimate import Closure, linearised

_A_SUBMAP = 3  # knots
_GAP = 5.0  # times the usual interval between pings, after which a line has ended
_MOST = 4000  # knots between submaps: their covariance is held at once
_APART_S = 1e-3  # between a knot and a submap's time


@dataclass(frozen=True)
class Knots:
    """The correction at k times."""

    time_s: np.ndarray  # (k,) rising
    moved: np.ndarray  # (k, 3) x, y (metres) and yaw, after less before
    covariance: np.ndarray  # (k, 3, 3) after
    before: np.ndarray  # (k, 3, 3) of navigation


def solve(
    pings: pd.DataFrame, navigation: Navigation, rates: drift.Settings, closures: Sequence[Closure], poses: np.ndarray
) -> Knots:
    """Return the correction along the track of pings (survey.PINGS).

    Args:
        pings: by rising time.
        navigation: the submaps.
        rates: the drift that the survey was closed with.
        closures: those accepted, and the ties that are known beforehand.
        poses: (n, 3) of the submaps, as the closures have them.
    """
    times = knot_times(pings["time_s"].to_numpy(), navigation.time_s)
    xy = np.column_stack([np.interp(times, pings["time_s"], pings[axis]) for axis in ("x_m", "y_m")])
    n = len(navigation.time_s)
    when = np.concatenate([navigation.time_s, times])
    order = np.argsort(when, kind="stable")
    row = np.argsort(order)
    place = np.concatenate([navigation.poses[:, :2], xy])[order]
    cross, own = drift.relations(when[order], place, rates, row[:n], navigation.fix)
    own, knots = own[row[n:]], (3 * row[n:, None] + np.arange(3)).ravel()
    J, r = linearised(closures, poses)
    # S by the same path as the rest: variances must stay above zero
    C = cross[:, (3 * row[:n, None] + np.arange(3)).ravel()]
    root = np.linalg.cholesky(J @ np.asarray((J @ C).T) + np.eye(len(r)))
    half = linalg.solve_triangular(root, J @ cross[:, knots], lower=True)
    right = linalg.solve_triangular(root, r + J @ (navigation.poses - poses).ravel(), lower=True)
    blocks = half.reshape(len(r), len(times), 3)
    moved = -(half.T @ right).reshape(len(times), 3)
    return Knots(times, moved, own - np.einsum("mki,mkj->kij", blocks, blocks), own)


def knot_times(pings: np.ndarray, submaps: np.ndarray) -> np.ndarray:
    """Return the times of knots: evenly between submaps, and at the first and last ping of every line.

    They are no submap's own times, at which the covariance would be singular.
    """
    steps = np.diff(np.unique(pings))
    # swaths of one ping may follow each other by milliseconds: what is usual is the longer of two kinds of steps
    usual = float(np.quantile(steps, 0.9)) if len(steps) else 1.0
    gaps = np.flatnonzero(np.diff(pings) > max(_GAP * usual, _APART_S))
    ends = np.concatenate([pings[[0, -1]], pings[gaps], pings[gaps + 1]])
    each = max(1, min(_A_SUBMAP, _MOST // max(len(submaps), 1)))
    between = np.interp(np.arange(each * len(submaps)) / each, np.arange(len(submaps)), submaps)
    times = np.unique(np.clip(np.concatenate([ends, between]), pings[0], pings[-1]))
    nearest = submaps[np.abs(times[:, None] - submaps).argmin(axis=1)]
    times = np.unique(np.where(np.abs(times - nearest) < _APART_S, nearest + 2 * _APART_S, times))
    return times[np.append(True, np.diff(times) > _APART_S)]


def table(pings: pd.DataFrame, knots: Knots) -> pd.DataFrame:
    """Return the track (result.TRACK) of pings, corrected as the knots say."""
    time = pings["time_s"].to_numpy()
    values = {name: np.interp(time, knots.time_s, knots.moved[:, k]) for k, name in enumerate(_MOVED)}
    for prefix, covariance in (("", knots.covariance), ("before_", knots.before)):
        for name, (i, j) in _VARIANCES.items():
            values[prefix + name] = np.interp(time, knots.time_s, covariance[:, i, j])
    return pings.assign(**values)[TRACK.names]


def unmoved(pings: pd.DataFrame) -> pd.DataFrame:
    """Return the track of pings that stay where they were, of which nothing is known."""
    unknown = np.full((1, 3, 3), np.nan)
    return table(pings, Knots(np.zeros(1), np.zeros((1, 3)), unknown, unknown))


_MOVED = ("moved_x_m", "moved_y_m", "moved_yaw_rad")
_VARIANCES = {"var_xx_m2": (0, 0), "var_xy_m2": (0, 1), "var_yy_m2": (1, 1), "var_yaw_rad2": (2, 2)}
