"""A small corrected survey: three lines to and fro in two raw files, nine submaps, and closures of every kind."""

import dataclasses

import numpy as np
import pandas as pd

from pointnetkl.correction.result import CLOSURES, TRACK, Corrected, Submaps, Verdict
from pointnetkl.slam.closing.estimate import Tie, from_matrices
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import rotate
from pointnetkl.surveys.survey import SUBMAPS, SWATHS

BEGIN_S = 1_500_000_000.25  # 14 July 2017
FILES = ("first.all", "second.all")  # lines 0 and 1, and line 2
LINE_M, APART_M, SPEED_M_S, BREAK_S = 300.0, 60.0, 2.0, 200.0
UTM = "EPSG:32633"
ORIGIN = (600_000.0, 6_000_000.0)  # 1.5 degrees east of the zone's middle: grid north is not north
RESIDUAL = np.array([0.03, -0.02])  # from the corrected place of a source to where it registers, metres
V = np.array([[0.04, 0.01], [0.01, 0.02]])

# source, targets, state, directions held; the last one lies on a reference
_CLOSURES = (
    (4, (1,), "accepted", 2),
    (5, (0,), "accepted", 1),
    (6, (5,), "outvoted", 2),
    (7, (4, 1), "accepted", 2),
    (3, (2,), "unmatched", 0),
    (8, (-1,), "accepted", 2),
)


def corrected(crs: str = UTM, heads: int = 1, applied: bool = True, seed: int = 0) -> Corrected:
    """Return the survey; with two heads every ping has another one at the same time and place."""
    track = _track(heads, applied, np.random.default_rng(seed))
    submaps = _submaps(track)
    origin = (0.0, 0.0) if crs == "local" else ORIGIN
    return Corrected(
        "small", SWATHS, crs, origin, ["water line"], track, submaps, _closures(submaps), _verdict(applied)
    )


def of_submaps(crs: str = "local") -> Corrected:
    """Return a survey of submaps that another program has posed: a row each, and times that only count."""
    survey = corrected(crs)
    submaps = survey.submaps
    assert submaps is not None
    count = np.arange(len(submaps.number), dtype=np.float64)
    track = survey.track.iloc[np.searchsorted(survey.track["time_s"], submaps.time_s)].reset_index(drop=True)
    names = [f"submap_{k}.pcd" for k in submaps.number]
    track = track.assign(ping=submaps.number.astype(np.int32), time_s=count, file=names, roll_rad=0.0, pitch_rad=0.0)
    closures = survey.closures.assign(time_s=count[survey.closures["source"]], target_time_s=None)
    posed = dataclasses.replace(submaps, time_s=count)
    return dataclasses.replace(survey, kind=SUBMAPS, track=track, submaps=posed, closures=closures)


def without_closures() -> Corrected:
    """Return the survey with no closure found."""
    return dataclasses.replace(corrected(), closures=CLOSURES.empty_table().to_pandas())


def with_track(survey: Corrected, **columns: object) -> Corrected:
    """Return the survey with other columns in its track."""
    return dataclasses.replace(survey, track=survey.track.assign(**columns))


def after(track: pd.DataFrame) -> np.ndarray:
    """Return the corrected places and yaws (n, 3) of pings: x, y, yaw in the map frame."""
    moved = track[["moved_x_m", "moved_y_m", "moved_yaw_rad"]].to_numpy()
    return np.asarray(track[["x_m", "y_m", "yaw_rad"]].to_numpy() + moved)


def _track(heads: int, applied: bool, rng: np.random.Generator) -> pd.DataFrame:
    along = np.arange(0.0, LINE_M + SPEED_M_S / 2, SPEED_M_S)
    steps, line = np.tile(np.arange(len(along)), 3), np.repeat(np.arange(3), len(along))
    back = line % 2 == 1
    time = BEGIN_S + steps + line * (len(along) - 1 + BREAK_S)
    run = (time - time[0]) / (time[-1] - time[0])  # drift grows from 0 to 1
    track = pd.DataFrame({"time_s": time, "file": np.where(line < 2, *FILES)})
    track = track.assign(x_m=np.where(back, LINE_M - along[steps], along[steps]), y_m=APART_M * line + 0.5 * run)
    track = track.assign(z_m=-20.0 + 0.3 * np.sin(time / 7), roll_rad=0.02 * np.sin(time / 3), pitch_rad=0.01)
    track = track.assign(yaw_rad=np.where(back, np.pi, 0.0) + 0.01 * rng.standard_normal(len(time)))
    moved = {"moved_x_m": -2.0 * run, "moved_y_m": 1.5 * run, "moved_yaw_rad": 0.004 * run}
    track = track.assign(**{name: applied * shift for name, shift in moved.items()})
    after_ = {"xx_m2": 0.01 + 0.04 * run, "xy_m2": 0.01 * run, "yy_m2": 0.02 + 0.03 * run, "yaw_rad2": 1e-5 + 0 * run}
    before = {"xx_m2": 0.01 + 4 * run, "xy_m2": 0.5 * run, "yy_m2": 0.02 + 2 * run, "yaw_rad2": 1e-5 + 1e-4 * run}
    track = track.assign(**{f"var_{name}": value for name, value in (after_ if applied else before).items()})
    track = track.assign(**{f"before_var_{name}": value for name, value in before.items()})
    track = track.loc[track.index.repeat(heads)].reset_index(drop=True)
    return track.assign(ping=np.arange(len(track), dtype=np.int32))[TRACK.names]


def _submaps(track: pd.DataFrame) -> Submaps:
    times = np.unique(track["time_s"])
    thirds = np.array_split(times, 9)
    middles = np.array([times_[len(times_) // 2] for times_ in thirds])
    rows = track.iloc[np.searchsorted(track["time_s"], middles)]
    places = rows[["x_m", "y_m", "z_m"]].to_numpy()
    moved = rows[["moved_x_m", "moved_y_m"]].to_numpy()
    yaw, turned = rows["yaw_rad"].to_numpy(), rows["moved_yaw_rad"].to_numpy()
    before = np.array([pose.matrix(place, at) for place, at in zip(places, yaw, strict=True)])
    places[:, :2] += moved
    poses = np.array([pose.matrix(place, at) for place, at in zip(places, yaw + turned, strict=True)])
    covariance = np.zeros((9, 3, 3))
    covariance[:, :2, :2] = rows[["var_xx_m2", "var_xy_m2", "var_xy_m2", "var_yy_m2"]].to_numpy().reshape(-1, 2, 2)
    covariance[:, 2, 2] = rows["var_yaw_rad2"]
    covariance[:, 0, 2] = covariance[:, 2, 0] = 1e-4
    return Submaps(np.arange(9), middles, np.repeat(np.arange(3), 3), before, poses, covariance, 100.0, 0.5)


def _closures(submaps: Submaps) -> pd.DataFrame:
    before, after_ = from_matrices(submaps.before), from_matrices(submaps.after)
    rows = [_closure(submaps, before, after_, *closure) for closure in _CLOSURES]
    return pd.DataFrame(rows)[CLOSURES.names]


def _closure(
    submaps: Submaps,
    before: np.ndarray,
    after_: np.ndarray,
    source: int,
    targets: tuple[int, ...],
    state: str,
    rank: int,
) -> dict[str, object]:
    lever = np.array([3.0, 20.0])
    middle = submaps.after[source][:2, :2] @ lever + after_[source, :2]
    row: dict[str, object] = dict.fromkeys(CLOSURES.names)
    row |= {"source": source, "target": targets[0], "rank": rank}
    row["targets"] = " ".join(str(k) for k in targets if k >= 0)
    row |= {"time_s": submaps.time_s[source], "x_m": middle[0], "y_m": middle[1], "overlap_m2": 900.0, "state": state}
    row |= {
        "target_time_s": submaps.time_s[targets[0]] if targets[0] >= 0 else None,
        "weight": float(state == "accepted"),
    }
    if rank:
        # a closure is searched from the corrected poses, and its shift is in their axes
        tie = None if targets[0] < 0 else Tie.at(after_, source, list(targets), None, lever)
        there = before[source, :2] + rotate(lever, before[source, 2])
        shift = RESIDUAL - (there - middle if tie is None else tie.offset(before))
        row |= {"shift_x_m": shift[0], "shift_y_m": shift[1], "residual_m": 0.1}
        row |= {"sigmas_before": 9.0, "sigmas_after": 0.3, "left_out_m": 0.2}
    if rank == 2:
        row |= {"v_xx_m2": V[0, 0], "v_xy_m2": V[0, 1], "v_yy_m2": V[1, 1]}
    return row


def _verdict(applied: bool) -> Verdict:
    sentence = "The track was corrected." if applied else "The track is left as it was."
    return Verdict(applied, sentence, 6, 4, 2.4, 0.2, 0.001, 0.5, 0.2, 1.3, "dead reckoning: 0.1 % of the distance")
