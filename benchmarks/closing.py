"""Surveys closed from their own navigation, on fresh seeds: errors before and after, and how sure poses are of them.

Every survey of `simulate` is sailed anew with other seeds of terrain and drift, and its lines drawn together until
swaths overlap. Its submaps lie where navigation has them; slam.closing finds their loop closures and solves. Errors are
the root mean square in the plane, as it is, after the best fit of a shift and a turn, and between the submaps that a
closure joins. NEES is the mean of e^T M^-1 e / 2 over poses: 1 is right. `worse` counts runs that end more than 2 %
worse than navigation, as it is. `--drift` are factors of the sigmas that are believed. `--flat` levels the terrain
below the noise: nothing should move. `--wrong` moves that share of closures by 8 to 15 m before they are judged.
"""
# ruff: noqa: E402

import os

for library in ("OPENBLAS", "MKL", "NUMBA", "OMP"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import argparse
import dataclasses
import json
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

import placed
import submaps
from pointnetkl import simulation
from pointnetkl.registration import gicp, pair
from pointnetkl.reporting import text_table
from pointnetkl.simulation import seabed, vehicle
from pointnetkl.slam.closing import drift, survey
from pointnetkl.slam.closing.estimate import from_matrices
from pointnetkl.slam.graph import trajectory_error
from pointnetkl.surveys import pose
from pointnetkl.workflow import command, parameters, study

SEEDS = (
    500_000  # apart from those of the surveys, of benchmarks/placed.py, and of everything that numbers were chosen on
)
LEVEL = seabed.Field([1e-6, 1e-6], 200.0)

Row = dict[str, Any]


@dataclasses.dataclass
class Sailed:
    """The submaps of a survey, as navigation has them, and where they truly lie."""

    clouds: list[np.ndarray]
    navigation: np.ndarray  # (n, 4, 4)
    truth: np.ndarray  # (n, 4, 4)
    time_s: np.ndarray  # (n,)
    fix: drift.Fix
    drift: drift.Settings


def main(arguments: argparse.Namespace) -> None:
    """Sail, close and print a table; with --json a line of JSON after it."""
    settings = parameters.read(arguments.params, "registration", gicp.Settings)
    registration = pair.Settings(**dataclasses.asdict(settings), method="map")
    runs = [
        (name, seed) for name in arguments.surveys for seed in range(arguments.first, arguments.first + arguments.seeds)
    ]
    rows = [
        {"survey": name, "seed": seed} | row
        for name, seed in tqdm(runs, desc="closing", unit="survey", dynamic_ncols=True)
        for row in close(arguments, name, seed, registration)
    ]
    table = summary(pd.DataFrame(rows))
    print(text_table.markdown([text_table.block("Surveys closed from their navigation", table, list(table[0]))]))
    if arguments.json:
        asked = {name: value for name, value in vars(arguments).items() if name not in ("params", "json")}
        print(json.dumps(text_table.rounded(asked | {"table": table})))


def close(arguments: argparse.Namespace, name: str, seed: int, registration: pair.Settings) -> Iterator[Row]:
    """Yield a row for navigation and each believed drift of a survey that is sailed with another seed."""
    line = study.survey(arguments.params, name)
    sailed = sail(arguments, name, seed, line.point_spacing_m, line.submap_length_m)
    for factor in arguments.drift:
        covariance = drift.covariance(
            sailed.time_s, sailed.navigation[:, :2, 3], sailed.drift.times(factor), sailed.fix
        )
        closed = survey.close(
            sailed.clouds, sailed.navigation, covariance, line.point_spacing_m, survey.Settings(), registration
        )
        if arguments.wrong:
            closed = spoiled(closed, arguments.wrong, seed)
        ties = [f.closure.tie for f in closed.found if f.closure is not None]
        states = Counter(str(f.state) for f in closed.found)
        before, after = (
            errors(poses, sailed.truth, believed.marginals, ties)
            for poses, believed in ((sailed.navigation, closed.navigation), (closed.poses, closed.estimate))
        )
        yield {
            "drift": factor,
            **{f"before_{key}": value for key, value in before.items()},
            **after,
            "worse": float(after["as_it_is_m"] > 1.02 * before["as_it_is_m"]),
            "closures": len(closed.found),
            "accepted": states["accepted"],
            "flat": states["flat"],
            "refused": len(closed.found) - states["accepted"] - states["flat"],
            "rounds": closed.rounds,
        }


def spoiled(closed: survey.Closed, share: float, seed: int) -> survey.Closed:
    """Return a survey solved again after a share of its closures that hold have got ends 8 to 15 m off."""
    rng, found = np.random.default_rng([seed, 4]), list(closed.found)
    for k, f in enumerate(found):
        if f.closure is not None and f.closure.rank and rng.random() < share:
            angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(8, 15)
            offset = far * np.array([np.cos(angle), np.sin(angle)])
            wrong = dataclasses.replace(f.closure, c=f.closure.c + f.closure.A @ offset)
            found[k] = dataclasses.replace(f, closure=wrong)
    judged, estimate = survey.judge(closed.navigation, found, survey.Settings())
    poses = survey.to_matrices(estimate.poses, closed.poses)
    return dataclasses.replace(closed, poses=poses, estimate=estimate, found=judged)


def errors(poses: np.ndarray, truth: np.ndarray, marginals: np.ndarray, ties: list[Any]) -> dict[str, float]:
    """Return the errors of poses, and their NEES."""
    e = (poses - truth)[:, :2, 3]
    aligned = trajectory_error.align_se2(poses[:, :3, 3], truth[:, :3, 3])
    plane, true = from_matrices(poses), from_matrices(truth)
    misses = np.array([tie.offset(plane) - tie.offset(true) for tie in ties]).reshape(-1, 2)
    squares = [x @ np.linalg.solve(M, x) / 2 for x, M in zip(e, marginals[:, :2, :2], strict=True)]
    return {
        "as_it_is_m": float(np.sqrt(np.mean(np.sum(e**2, axis=1)))),
        "se2_m": trajectory_error.rmse(aligned[:, :2], truth[:, :2, 3]),
        "joined_m": float(np.sqrt(np.mean(np.sum(misses**2, axis=1)))) if len(misses) else float("nan"),
        "nees": float(np.mean(squares)),
    }


def sail(arguments: argparse.Namespace, name: str, seed: int, spacing_m: float, length_m: float) -> Sailed:
    """Return a survey of another seed, cut into submaps."""
    settings = parameters.read(arguments.params, f"simulate.{name}", simulation.Settings)
    if settings.terrain is None:
        raise submaps.BenchmarkError(f"{name} has no terrain that another seed would change; leave it out")
    layout = dataclasses.replace(settings.layout, line_spacing_m=min(settings.layout.line_spacing_m, placed.WIDEST_M))
    settings = dataclasses.replace(settings, seed=settings.seed + SEEDS + 10_000 * seed, layout=layout)
    terrain = level(settings.terrain) if arguments.flat else settings.terrain
    sailing = parameters.read(arguments.params, f"vehicles.{settings.vehicle}", vehicle.Settings)
    easting, northing = settings.centre_m
    ground = seabed.Random(terrain, settings.seed, settings.crs, (easting, northing))
    lines = list(simulation.survey(settings, sailing, ground))
    cut = [submap for line in lines for submap in stretches(line, length_m, spacing_m)]
    clouds, navigation, truth, times = zip(*cut, strict=True)
    start = lines[0].truth.iloc[0]
    fix = drift.Fix(*(float(start[key]) for key in ("time_s", "x_m", "y_m")))
    return Sailed(list(clouds), np.array(navigation), np.array(truth), np.array(times), fix, of(sailing.navigation))


def stretches(
    line: simulation.Line, length_m: float, spacing_m: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, float]]:
    """Yield the points (n, 3), the pose by navigation and in truth, and the time, of each whole stretch of a line."""
    raw, truth = line.raw[line.raw["quality"] == 0], line.truth
    north, east = np.cos(raw["heading_rad"]), np.sin(raw["heading_rad"])
    x = raw["x_m"] + east * raw["along_m"] + north * raw["across_m"]
    y = raw["y_m"] + north * raw["along_m"] - east * raw["across_m"]
    points = np.column_stack([x, y, -raw["depth_m"] - raw["down_m"]])
    pings = raw.drop_duplicates("time_s")
    true = np.unwrap(truth["yaw_rad"])
    yaw = np.pi / 2 - np.unwrap(pings["heading_rad"])
    sailed = np.concatenate([[0], np.cumsum(np.hypot(np.diff(truth["x_m"]), np.diff(truth["y_m"])))])
    stretch = np.interp(raw["time_s"], truth["time_s"], sailed) // length_m
    for number in range(int(sailed[-1] // length_m)):
        time = float(np.interp((number + 0.5) * length_m, sailed, truth["time_s"]))
        at = [np.interp(time, pings["time_s"], values) for values in (pings["x_m"], pings["y_m"], yaw)]
        there = [np.interp(time, truth["time_s"], values) for values in (truth["x_m"], truth["y_m"], true)]
        depth = float(np.interp(time, truth["time_s"], truth["z_m"]))
        T, T_true = (pose.matrix(np.array([p[0], p[1], depth]), float(p[2])) for p in (at, there))
        yield placed.thinned(pose.transform(np.linalg.inv(T), points[stretch == number]), spacing_m), T, T_true, time


def level(terrain: seabed.Settings) -> seabed.Settings:
    """Return a terrain without relief."""
    plain = dataclasses.replace(terrain.relief, height_m=1e-3)
    return seabed.Settings(terrain.depth_m, terrain.patch_m, plain, LEVEL, LEVEL)


def of(navigation: vehicle.Navigation) -> drift.Settings:
    """Return the drift of a simulated vehicle."""
    heading, correlation = float(np.deg2rad(navigation.heading_error_deg)), navigation.correlation_s
    return drift.Settings(
        navigation.scale_error, heading, heading, correlation, navigation.velocity_error_mps, correlation
    )


def summary(table: pd.DataFrame) -> list[Row]:
    """Return a row for each survey and believed drift: root mean squares of errors, means of all else."""
    rows = []
    for factor, believed in table.groupby("drift", sort=False):
        for name, some in [*believed.groupby("survey", sort=False), ("all", believed)]:
            row: Row = {"survey": name, "drift": factor, "runs": len(some)}
            for key in [key for key in some if key not in ("survey", "seed", "drift")]:
                squared = key.endswith("_m")
                row[key] = float(np.sqrt(np.mean(some[key] ** 2)) if squared else some[key].mean())
            rows.append(row | {"worse": int(some["worse"].sum())})
    return rows


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    names = ["borno_8", "thwaites_11", "baltic", "shetland", "antarctica_7"]
    parser.add_argument("--surveys", nargs="+", default=names, help="of section simulate")
    parser.add_argument("--seeds", type=int, default=2, help="of each survey")
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--drift", type=float, nargs="+", default=[1.0], help="believed, as factors of the true one")
    parser.add_argument("--flat", action="store_true", help="level the terrain")
    parser.add_argument("--wrong", type=float, default=0.0, help="share of closures that get wrong ends")
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    return parser


if __name__ == "__main__":
    command.run(main, options())
