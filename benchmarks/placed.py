"""Errors of loop closures whose submaps lie where they truly do, and how well Q tells them: GICP's ends and MAP's.

Every survey of `simulate` is sailed anew with other seeds of terrain and drift, and its lines drawn together until
swaths overlap. A submap is the soundings of a stretch of track, thinned; it is moved by the mean error of its own
navigation, so that what is left is the shape that drift gives it. Each is registered to the submaps of earlier lines
from a start that is N(0, prior) off. `share` is the least share of the stiffness that is ground: weak below 0.5, held
above 0.9. `force` is f^T S^-1 f / M at the true place: 1 where blocks tell all of the variance. `--drift none` sails
with navigation that knows, and shows what of it is drift.

With --halves K, what one submap tells before there is a pair judges the same errors of MAP: `halves` is the covariance
of K registrations by MAP of its soundings' halves, drawn anew each time, the best that a model of single submaps could
learn; `own` is Q in closed form, with the mean of K halves' information in place of the pair's.
"""
# ruff: noqa: E402

import os

for library in ("OPENBLAS", "MKL", "NUMBA", "OMP"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import argparse
import dataclasses
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from tqdm import tqdm

import submaps
from pointnetkl import simulation
from pointnetkl.registration import gicp, monte_carlo, pair
from pointnetkl.registration.pair import covariance, factor
from pointnetkl.reporting import text_table
from pointnetkl.simulation import seabed, vehicle
from pointnetkl.surveys.se2 import SE2
from pointnetkl.workflow import command, parameters, study

GATES = factor.Settings()
KNOWN = vehicle.Navigation(0.0, 0.0, 0.0, 300.0)
WIDEST_M = 60.0  # between lines: swaths of 200 m overlap by more than half
MEASURES = ("nees", "in_95", "nats")
CLASSES = {"weak": (-np.inf, 0.5), "between": (0.5, 0.9), "held": (0.9, np.inf)}

Row = dict[str, Any]


def main(arguments: argparse.Namespace) -> None:
    """Sail, register and print a table; with --json a line of JSON after it."""
    if arguments.halves == 1 or arguments.halves < 0:
        raise submaps.BenchmarkError(f"--halves is {arguments.halves}, must be 0, or 2 and above for a covariance")
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    settings = pair.Settings.of(registration, "map")
    prior_m2 = parameters.read(arguments.params, "label", monte_carlo.Settings).prior_variance_m2
    sailed = [(survey, seed) for survey in arguments.surveys for seed in range(arguments.seeds)]
    rows = [
        {"survey": survey} | row
        for survey, seed in tqdm(sailed, desc="placed", unit="survey", dynamic_ncols=True)
        for row in closures(arguments, survey, seed, settings, prior_m2)
    ]
    if not rows:
        raise submaps.BenchmarkError("no submap returns to mapped ground; sail more --surveys or --seeds")
    table = summary(pd.DataFrame(rows))
    print(
        text_table.markdown([text_table.block("Loop closures with every submap in its place", table, list(table[0]))])
    )
    if arguments.json:
        asked = {name: value for name, value in vars(arguments).items() if name not in ("params", "json")}
        print(json.dumps(text_table.rounded(asked | {"closures": len(rows), "classes": table})))


def closures(
    arguments: argparse.Namespace, survey: str, seed: int, settings: pair.Settings, prior_m2: float
) -> Iterator[Row]:
    """Yield a row for each loop closure of a survey that is sailed with another seed."""
    line = study.survey(arguments.params, survey)
    numbers = covariance.Settings(submap_length_m=line.submap_length_m)
    soundings = list(sail(arguments, survey, seed, line.submap_length_m))
    clouds = [(number, thinned(points, line.point_spacing_m)) for number, points in soundings]
    rng, rng_halves = np.random.default_rng([seed, 3]), np.random.default_rng([seed, 4])
    for (number, source), (_, points) in zip(clouds, soundings, strict=True):
        start = rng.normal(0, np.sqrt(prior_m2), 2)
        centre = source.mean(axis=0)
        mapped = [
            cloud
            for other, cloud in clouds
            if other < number and np.hypot(*(cloud.mean(axis=0) - centre)[:2]) < 2.5 * line.submap_length_m
        ]
        if not mapped:
            continue
        target = np.concatenate(mapped)
        common = cKDTree(target[:, :2]).query(source[:, :2] + start)[0] < line.point_spacing_m
        if common.mean() >= arguments.coverage:
            clouds_of_pair = gicp.prepare(source[common] - centre, settings), gicp.prepare(target - centre, settings)
            row, error = closure(clouds_of_pair, start, line.point_spacing_m, settings, prior_m2, numbers)
            if arguments.halves:
                how = (line.point_spacing_m, settings, prior_m2, numbers)
                alone = halves(points - centre, arguments.halves, rng_halves, *how)
                row |= {key: value for name, Q in alone.items() for key, value in judged(name, error, Q).items()}
            yield row


def sail(arguments: argparse.Namespace, survey: str, seed: int, length_m: float) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the number of a line and the soundings (n, 3), in metres, of each submap of it, in its place."""
    settings = parameters.read(arguments.params, f"simulate.{survey}", simulation.Settings)
    if settings.terrain is None:
        raise submaps.BenchmarkError(f"{survey} has no terrain that another seed would change; leave it out")
    layout = dataclasses.replace(settings.layout, line_spacing_m=min(settings.layout.line_spacing_m, WIDEST_M))
    settings = dataclasses.replace(settings, seed=settings.seed + 10_000 * (seed + 1), layout=layout)
    sailing = parameters.read(arguments.params, f"vehicles.{settings.vehicle}", vehicle.Settings)
    if arguments.drift == "none":
        sailing = dataclasses.replace(sailing, navigation=KNOWN)
    easting, northing = settings.centre_m
    ground = seabed.Random(settings.terrain, settings.seed, settings.crs, (easting, northing))
    for number, line in enumerate(simulation.survey(settings, sailing, ground)):
        for points in stretches(line, length_m):
            yield number, points


def stretches(line: simulation.Line, length_m: float) -> Iterator[np.ndarray]:
    """Yield the soundings (n, 3) of each whole stretch of a line, moved by the mean error of their navigation."""
    raw, truth = line.raw[line.raw["quality"] == 0], line.truth
    north, east = np.cos(raw["heading_rad"]), np.sin(raw["heading_rad"])
    x = raw["x_m"] + east * raw["along_m"] + north * raw["across_m"]
    y = raw["y_m"] + north * raw["along_m"] - east * raw["across_m"]
    points = np.column_stack([x, y, -raw["depth_m"] - raw["down_m"]])
    true = np.column_stack([np.interp(raw["time_s"], truth["time_s"], truth[name]) for name in ("x_m", "y_m")])
    error = raw[["x_m", "y_m"]].to_numpy() - true
    sailed = np.concatenate([[0], np.cumsum(np.hypot(np.diff(truth["x_m"]), np.diff(truth["y_m"])))])
    stretch = np.interp(raw["time_s"], truth["time_s"], sailed) // length_m
    for number in range(int(sailed[-1] // length_m)):
        own = stretch == number
        yield points[own] - np.append(error[own].mean(axis=0), 0.0)


def thinned(points: np.ndarray, spacing_m: float) -> np.ndarray:
    """Return one of the points (n, 3) of every cell."""
    return points[np.unique(np.floor(points[:, :2] / spacing_m), axis=0, return_index=True)[1]]


def closure(
    clouds: tuple[gicp.Cloud, gicp.Cloud],
    start: np.ndarray,
    spacing_m: float,
    settings: pair.Settings,
    prior_m2: float,
    numbers: covariance.Settings,
) -> tuple[Row, np.ndarray]:
    """Return how far both methods end from the truth, and how well Q tells it; and MAP's error (2,), metres."""
    prior, block_m = prior_m2 * np.eye(2), numbers.block_spacings * spacing_m
    truth = pair.at(*clouds, SE2.identity(), block_m, settings)
    S = truth.variance + covariance.LEAST_VARIANCE_M2 * np.eye(2)
    row: Row = {"force": float(truth.total @ np.linalg.solve(S, truth.total)) / 2}
    for method in pair.METHODS:
        end = pair.register(*clouds, prior, spacing_m, dataclasses.replace(settings, method=method), SE2(start, 0.0))
        error = end.T_target_source.translation
        Q = covariance.with_prior(covariance.information(end.forces, numbers), prior, end.forces.lever_m, numbers)
        row |= {f"{method}_error_m": float(np.hypot(*error))} | judged(method, error, Q)
    row["share"] = float(factor.of(end.forces, numbers, GATES).shares[0])  # of MAP's end, the last
    return row, error


def judged(name: str, error: np.ndarray, Q: np.ndarray) -> Row:
    """Return how well a covariance (2, 2) tells an error (2,)."""
    square = float(error @ np.linalg.solve(Q, error))
    nats = 0.5 * (float(np.linalg.slogdet(2 * np.pi * Q)[1]) + square)
    return {f"{name}_nees": square / 2, f"{name}_in_95": float(square < 5.991), f"{name}_nats": nats}


def halves(
    points: np.ndarray,
    runs: int,
    rng: np.random.Generator,
    spacing_m: float,
    settings: pair.Settings,
    prior_m2: float,
    numbers: covariance.Settings,
) -> dict[str, np.ndarray]:
    """Return covariances (2, 2) of a submap's soundings (n, 3) that are registered half to half, and Q from them.

    Both have b for drift inside the submap, as Q of a pair has.
    """
    prior, block_m = prior_m2 * np.eye(2), numbers.block_spacings * spacing_m
    errors, information = np.empty((runs, 2)), np.zeros((2, 2))
    for k in range(runs):
        first = rng.random(len(points)) < 0.5
        clouds = [gicp.prepare(thinned(points[half], spacing_m), settings) for half in (first, ~first)]
        start = SE2(rng.normal(0, np.sqrt(prior_m2), 2), 0.0)
        errors[k] = pair.register(*clouds, prior, spacing_m, settings, start).T_target_source.translation
        forces = pair.at(*clouds, SE2.identity(), block_m, settings)
        information += covariance.information(forces, numbers) / runs
    return {
        "halves": monte_carlo.covariance(errors) + numbers.drift_m2 * np.eye(2),
        "own": covariance.with_prior(information, prior, forces.lever_m, numbers),
    }


def summary(table: pd.DataFrame) -> list[Row]:
    """Return a row for each survey and class of ground that has closures."""
    rows = []
    for survey, closed in [*table.groupby("survey", sort=False), ("all", table)]:
        for name, (low, high) in CLASSES.items():
            some = closed[(closed["share"] >= low) & (closed["share"] < high)]
            if len(some):
                rows.append({"survey": survey, "ground": name, "closures": len(some)} | _means(some))
    return rows


def _means(closed: pd.DataFrame) -> Row:
    row: Row = {"force": float(closed["force"].mean())}
    for method in pair.METHODS:
        row[f"{method}_median_m"] = float(closed[f"{method}_error_m"].median())
        row[f"{method}_rms_m"] = float(np.sqrt((closed[f"{method}_error_m"] ** 2).mean()))
    for name in [*pair.METHODS, "halves", "own"]:
        if f"{name}_nees" in closed:
            row |= {f"{name}_{measure}": float(closed[f"{name}_{measure}"].mean()) for measure in MEASURES}
    return row


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    names = ["borno_8", "thwaites_11", "baltic", "shetland", "antarctica_7"]
    parser.add_argument("--surveys", nargs="+", default=names, help="of section simulate")
    parser.add_argument("--seeds", type=int, default=2, help="of each survey")
    parser.add_argument("--drift", choices=["sailed", "none"], default="sailed", help="of the navigation")
    parser.add_argument("--coverage", type=float, default=0.5, help="share of a submap that earlier ones must cover")
    parser.add_argument(
        "--halves", type=int, default=0, metavar="K", help="judge what K halves of one submap tell, too; 0: do not"
    )
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    return parser


if __name__ == "__main__":
    command.run(main, options())
