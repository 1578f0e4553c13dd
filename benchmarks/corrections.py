"""Raw surveys corrected by `correct`, against the truth: the twelve of closing.py, sailed and written as raw files.

Each is sailed several times (--times), with other ground, drift and noise. Errors are of the pings, in the plane: as it
is, and after the best fit of a shift and a turn (se2). `in_95` is the share of pings whose error lies in the 95 %
ellipse that track.csv gives. `map` is the rms of the map's depth less the true seabed's in the middle of its cells,
where both maps have soundings. `worse` counts surveys that a correction was applied to and made over 2 % worse.

--navigation gnss sails the same surveys on a ship with a satellite receiver: positions wander by 0.5 m, and so are
to be left as they were.
"""
# ruff: noqa: E402

import os

for library in ("OPENBLAS", "MKL", "NUMBA", "OMP"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import argparse
import contextlib
import functools
import io
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import rasterio

import closing
from closing import SURVEYS, Sailing
from pointnetkl import correction, simulation
from pointnetkl.correction import Inputs, Settings
from pointnetkl.reporting import text_table
from pointnetkl.slam.closing import drift
from pointnetkl.workflow import artifacts, command, compute, parameters

Row = dict[str, Any]
_CHI2_95 = 5.991  # of two degrees of freedom


def main(arguments: argparse.Namespace) -> None:
    """Sail, correct and print a table."""
    asked = [(name, time) for time in range(arguments.times) for name in arguments.surveys]
    rows = compute.over(functools.partial(corrected, arguments), asked, "correcting", unit="survey")
    table = sorted(rows, key=lambda row: (arguments.surveys.index(row["survey"]), row["time"]))
    print(text_table.markdown([text_table.block("Corrected surveys", table, list(table[0]))]))
    whole = summary(pd.DataFrame(table))
    print(text_table.markdown([text_table.block("All of them", whole, list(whole[0]))]))
    if arguments.json:
        print(json.dumps(text_table.rounded({"surveys": table, "all": whole})))


def corrected(arguments: argparse.Namespace, asked: tuple[str, int]) -> Row:
    """Return the errors of one survey before and after."""
    name, time = asked
    made = closing.prepared(arguments.params, SURVEYS[name], time)
    os.environ["POINTNETKL_WORKERS"] = "1"  # surveys run beside each other already
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stdout(io.StringIO()):
        folder = Path(scratch)
        truth = sail(made, folder / "raw", arguments.navigation, time)
        stated = parameters.read(arguments.params, "navigation", dict[str, drift.Settings])
        settings = Settings(navigation=arguments.navigation, drift=arguments.drift)
        result = correction.correct(Inputs([folder / "raw"], rates=stated), folder / "out", settings)
        before, after, inside, sigma = of_pings(result, truth)
        maps = map_errors(folder / "out", made)
    verdict = result.verdict
    row = {"survey": name, "time": time, "applied": "yes" if verdict.applied else "no"}
    row |= {"closures": verdict.closures, "accepted": verdict.accepted}
    row |= {"before_m": before[0], "after_m": after[0], "before_se2_m": before[1], "after_se2_m": after[1]}
    row |= {"in_95": inside, "sigma_m": sigma, "map_before_m": maps[0], "map_after_m": maps[1]}
    row |= {"left_out_before_m": verdict.left_out_before_m, "left_out_after_m": verdict.left_out_after_m}
    return row | {"overlaps_before_m": verdict.disagreement_before_m, "overlaps_after_m": verdict.disagreement_after_m}


def sail(made: Sailing, folder: Path, navigation: str, time: int) -> pd.DataFrame:
    """Write a survey's raw files, and return its true trajectory."""
    rng = np.random.default_rng([made.settings.seed, time, 9])
    lines = list(simulation.survey(made.settings, made.vehicle, made.ground))
    offset = _wander(pd.concat([line.truth for line in lines])["time_s"].to_numpy(), rng)
    for number, line in enumerate(lines):
        raw = line.raw if navigation == "dead-reckoning" else _by_satellite(line, offset)
        path = folder / f"line_{number:03d}.parquet"
        artifacts.write_table(path, raw, simulation.RAW, {}, crs=made.ground.crs)
    return pd.concat([line.truth for line in lines], ignore_index=True)


def _wander(time_s: np.ndarray, rng: np.random.Generator) -> pd.DataFrame:
    """Return errors of a satellite receiver: 0.5 m in x and y, alike for ten minutes."""
    keep = np.exp(-np.diff(time_s, prepend=time_s[0]) / 600)
    xy, steps = rng.normal(size=2), []
    for k in keep:
        xy = k * xy + np.sqrt(1 - k**2) * rng.normal(size=2)
        steps.append(0.5 * xy)
    return pd.DataFrame(np.array(steps), index=time_s, columns=["x_m", "y_m"])


def _by_satellite(line: simulation.Line, offset: pd.DataFrame) -> pd.DataFrame:
    truth = line.truth.set_index("time_s").loc[line.raw["time_s"]]
    there = offset.loc[line.raw["time_s"]]
    places = {axis: truth[axis].to_numpy() + there[axis].to_numpy() for axis in ("x_m", "y_m")}
    return line.raw.assign(**places, heading_rad=np.mod(np.pi / 2 - truth["yaw_rad"].to_numpy(), 2 * np.pi))


def of_pings(
    result: correction.Corrected, truth: pd.DataFrame
) -> tuple[tuple[float, float], tuple[float, float], float, float]:
    """Return rms errors before and after, as they are and aligned, the share in 95 % ellipses, and the rms sigma."""
    track = result.track
    there = {axis: np.interp(track["time_s"], truth["time_s"], truth[axis]) for axis in ("x_m", "y_m")}
    true = np.column_stack([there["x_m"] - result.origin[0], there["y_m"] - result.origin[1]])
    before = track[["x_m", "y_m"]].to_numpy()
    after = before + track[["moved_x_m", "moved_y_m"]].to_numpy()
    e = after - true
    cov = np.empty((len(e), 2, 2))
    cov[:, 0, 0], cov[:, 1, 1] = track["var_xx_m2"], track["var_yy_m2"]
    cov[:, 0, 1] = cov[:, 1, 0] = track["var_xy_m2"]
    squares = np.einsum("ki,ki->k", e, np.linalg.solve(cov + 1e-6 * np.eye(2), e[:, :, None])[:, :, 0])
    sigma = float(np.sqrt(np.trace(cov, axis1=1, axis2=2).mean()))
    return _errors(before, true), _errors(after, true), float(np.mean(squares < _CHI2_95)), sigma


def _errors(places: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    def rms(e: np.ndarray) -> float:
        return float(np.sqrt((e**2).sum(axis=1).mean()))

    centred, target = places - places.mean(axis=0), true - true.mean(axis=0)
    u, _, v = np.linalg.svd(centred.T @ target)
    flip = np.diag([1.0, np.sign(np.linalg.det(u @ v))])
    return rms(places - true), rms(centred @ (u @ flip @ v) - target)


def map_errors(folder: Path, made: Sailing) -> tuple[float, float]:
    """Return the rms of depth less the true seabed's over the cells of both maps, before and after, metres."""
    depths = []
    for name in ("map_before.tif", "map_after.tif"):
        with rasterio.open(folder / name) as file:
            depths.append(file.read(1))
            transform = file.transform
    row, column = np.nonzero(np.isfinite(depths[0]) & np.isfinite(depths[1]))
    x, y = transform * (column + 0.5, row + 0.5)
    true = -made.ground(x, y)
    before, after = (float(np.sqrt(np.mean((depth[row, column] - true) ** 2))) for depth in depths)
    return before, after


def summary(rows: pd.DataFrame) -> list[Row]:
    """Return the errors over all surveys, and over those of one ground."""
    kinds = {"all": rows, **{str(k): part for k, part in rows.groupby(rows["survey"].str.rstrip("_0123456789"))}}
    return [_pooled(name, part) for name, part in kinds.items()]


def _pooled(name: str, rows: pd.DataFrame) -> Row:
    def rms(column: str) -> float:
        return float(np.sqrt(np.mean(rows[column] ** 2)))

    worse = (rows["applied"] == "yes") & (rows["after_m"] > 1.02 * rows["before_m"])
    columns = ("before_m", "after_m", "before_se2_m", "after_se2_m", "map_before_m", "map_after_m")
    counts = {"surveys": len(rows), "applied": int((rows["applied"] == "yes").sum()), "worse": int(worse.sum())}
    return {"ground": name, **counts, **{column: rms(column) for column in columns}, "in_95": rows["in_95"].mean()}


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    names = list(SURVEYS)
    parser.add_argument(
        "--surveys", nargs="+", default=names, choices=names, metavar="SURVEY", help="which of the twelve"
    )
    parser.add_argument("--times", type=int, default=1, help="that each is sailed")
    parser.add_argument(
        "--navigation", default="dead-reckoning", choices=("dead-reckoning", "gnss"), help="sailed with"
    )
    parser.add_argument("--drift", default="", help="as of `correct`; empty: measured; simulated: as it was sailed")
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    return parser


if __name__ == "__main__":
    command.run(main, options())
