"""Twelve surveys of four kinds of ground closed from their own navigation, by every method (Table V on more ground).

They are sailed over terrains that no number was chosen on: flat (relief below the noise), ridges (one grain), patchy
(basins and rock, as the study's surveys), rugged, and a small harbour in half-metre cells. Numbers of the covariance
were changed once after they were first run, by other surveys (docs/closures.md). Each is sailed once; further drifts
are drawn about its truth (--drifts), and each is closed as pointnetkl.slam.closing.comparison does: `map` and `pair`
beside monte_carlo (--runs registrations a label), their mean `constant`, and, given --model, that network.

Errors are in the plane: as it is, after the best fit of a shift and a turn, and of submaps that return to mapped
ground, on that ground. `worse` counts runs that end over 2 % worse than navigation, as it is. `p` is of a t test,
clustered by survey, that map's error (SE2) is below that method's. --wrong solves method map again with that share of
its closures 8 to 15 m off.
"""
# ruff: noqa: E402

import os

for library in ("OPENBLAS", "MKL", "NUMBA", "OMP"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import argparse
import dataclasses
import functools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import placed
from pointnetkl import simulation
from pointnetkl.models import trained
from pointnetkl.registration import gicp, monte_carlo, pair
from pointnetkl.registration.covariance import catalogue, gaussian
from pointnetkl.registration.streams import Stream
from pointnetkl.reporting import intervals, text_table
from pointnetkl.reporting.closing import numbers
from pointnetkl.simulation import seabed, vehicle
from pointnetkl.slam.closing import comparison, drift, survey
from pointnetkl.slam.closing.comparison import Track
from pointnetkl.slam.closing.schemas import State
from pointnetkl.surveys import pose
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import command, compute, parameters, study

SEEDS = 500_000  # apart from those of the surveys, and of all that numbers were chosen on
LEVEL = seabed.Field([1e-6, 1e-6], 200.0)

Row = dict[str, Any]
Terrain = Callable[[seabed.Settings], seabed.Settings]


def flat(terrain: seabed.Settings) -> seabed.Settings:
    """Return a terrain without relief."""
    return seabed.Settings(terrain.depth_m, terrain.patch_m, _low(terrain), LEVEL, LEVEL)


def ridges(terrain: seabed.Settings) -> seabed.Settings:
    """Return a terrain with one grain, which holds a survey across it alone."""
    length, azimuth = terrain.texture.length_m, terrain.relief.azimuth_deg + 60
    grain = seabed.Field([0.01, 0.05], 2 * length, stretch=30.0, azimuth_deg=azimuth)
    return seabed.Settings(terrain.depth_m, terrain.patch_m, _low(terrain), LEVEL, LEVEL, ridges=grain)


def patchy(terrain: seabed.Settings) -> seabed.Settings:
    """Return the terrain as it is: from mud to rock."""
    return terrain


def rugged(terrain: seabed.Settings) -> seabed.Settings:
    """Return a terrain that is rock everywhere."""
    hills = dataclasses.replace(terrain.hills, slope=[0.05, 0.2])
    return dataclasses.replace(terrain, hills=hills, texture=dataclasses.replace(terrain.texture, slope=[0.01, 0.02]))


def harbour(terrain: seabed.Settings) -> seabed.Settings:
    """Return the ground of a harbour: dredged, some metres of relief, forms of metres."""
    low = dataclasses.replace(terrain.relief, height_m=3.0, length_m=80.0, stretch=3.0)
    hills, texture = seabed.Field([0.001, 0.1], 20.0), seabed.Field([0.0005, 0.02], 3.0, octaves=3)
    return seabed.Settings(20.0, 60.0, low, hills, texture)


def _low(terrain: seabed.Settings) -> seabed.Relief:
    return dataclasses.replace(terrain.relief, height_m=1e-3)


@dataclasses.dataclass(frozen=True)
class Plan:
    """A survey: whose layout and sonar it has, and its ground."""

    like: str  # a survey of section simulate
    terrain: Terrain
    seed: int
    scale: float = 1.0  # of all lengths but the terrain's


SURVEYS = {
    "flat_1": Plan("borno_8", flat, 1),
    "ridges_1": Plan("borno_8", ridges, 2),
    "ridges_2": Plan("thwaites_11", ridges, 3),
    "patchy_1": Plan("baltic", patchy, 4),
    "patchy_2": Plan("thwaites_11", patchy, 5),
    "rugged_1": Plan("shetland", rugged, 6),
    "flat_2": Plan("thwaites_11", flat, 7),
    "ridges_3": Plan("shetland", ridges, 8),
    "patchy_3": Plan("borno_8", patchy, 9),
    "rugged_2": Plan("antarctica_7", rugged, 10),
    "rugged_3": Plan("borno_8", rugged, 11),
    "harbour": Plan("borno_8", harbour, 12, 0.16),
}


def main(arguments: argparse.Namespace) -> None:
    """Sail, close and print tables; with --json a line of JSON after them."""
    close = functools.partial(closed, arguments)
    rows = pd.concat(compute.over(close, arguments.surveys, "closing", unit="survey"), ignore_index=True)
    if arguments.rows:
        rows.to_csv(arguments.rows, index=False, float_format="%.6g")
    by_survey, overall = summary(rows), pooled(rows)
    for caption, table in (("By survey", by_survey), ("All surveys", overall)):
        print(text_table.markdown([text_table.block(caption, table, list(table[0]))]))
    if arguments.json:
        asked = {
            name: value for name, value in vars(arguments).items() if name not in ("params", "json", "rows", "model")
        }
        print(json.dumps(text_table.rounded(asked | {"by_survey": by_survey, "all": overall})))


def closed(arguments: argparse.Namespace, name: str) -> pd.DataFrame:
    """Return the rows of one survey, as stage close writes them, and those with wrong closures."""
    settings = parameters.read(arguments.params, "close", comparison.Settings)
    settings = dataclasses.replace(settings, drifts=arguments.drifts, believed=arguments.believed)
    registration = parameters.read(arguments.params, "registration", pair.Settings)
    track = sail(arguments.params, name, SURVEYS[name])
    before = os.environ.get("POINTNETKL_WORKERS")
    os.environ["POINTNETKL_WORKERS"] = "1"  # surveys run beside each other already
    try:
        rivals = dict(covariances(arguments, track, registration))
        rows = [comparison.compare(track, rivals, settings, registration).rows]
    finally:
        os.environ.pop("POINTNETKL_WORKERS")
        if before is not None:
            os.environ["POINTNETKL_WORKERS"] = before
    rows += [pd.DataFrame(with_wrong(track, settings, registration, share)) for share in arguments.wrong]
    return pd.concat(rows, ignore_index=True)


def covariances(
    arguments: argparse.Namespace, track: Track, registration: pair.Settings
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the rivals' covariances (n, 2, 2): labels of copy same, their mean, and a network's."""
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    submaps = [Submap(track.survey, k, points, points, points) for k, points in enumerate(track.clouds)]
    labels = np.array([_label(submap, arguments.runs, label, registration.as_gicp) for submap in submaps])
    yield catalogue.MONTE_CARLO, labels
    yield catalogue.CONSTANT, np.tile(labels.mean(axis=0), (len(labels), 1, 1))
    if arguments.model:
        (model,) = trained.load_all([arguments.model], label, registration.as_gicp)
        yield catalogue.NETWORK, np.array([model.covariance(submap) for submap in submaps])


def _label(submap: Submap, runs: int, label: monte_carlo.Settings, registration: gicp.Settings) -> np.ndarray:
    rng = monte_carlo.generator(label, submap, Stream.LABEL)
    errors = monte_carlo.errors(submap, runs, rng, label, registration).errors
    return gaussian.with_floor(monte_carlo.covariance(errors), 1e-6)


def with_wrong(track: Track, settings: comparison.Settings, registration: pair.Settings, share: float) -> Iterator[Row]:
    """Yield the errors by map of each run, after a share of its closures that hold have got ends 8 to 15 m off."""
    for run in range(1 + settings.drifts):
        sailed = comparison.drawn(track, run, settings.seed)
        registration = dataclasses.replace(registration, method="map")
        whole = survey.close(
            sailed.clouds, sailed.navigation, sailed.covariance(1.0), sailed.spacing_m, settings.closing, registration
        )
        rng, found = np.random.default_rng([settings.seed, run, 4]), list(whole.found)
        for k, f in enumerate(found):
            if f.closure is not None and f.closure.rank and rng.random() < share:
                angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(8, 15)
                offset = far * np.array([np.cos(angle), np.sin(angle)])
                wrong = dataclasses.replace(f.closure, c=f.closure.c + f.closure.A @ offset, end=f.closure.end + offset)
                found[k] = dataclasses.replace(f, closure=wrong)
        judged, estimate = survey.judge(whole.navigation, found, settings.closing)
        poses = survey.to_matrices(estimate.poses, whole.poses)
        accepted = sum(f.state == State.ACCEPTED for f in judged)
        ties = [f.closure.tie for f in whole.found if f.closure is not None]
        key = {"survey": track.survey, "method": f"map, {100 * share:g} % wrong", "run": run, "believed": 1.0}
        counts = {"closures": len(judged), "accepted": accepted}
        yield key | comparison.errors(poses, estimate, track.truth, ties) | counts


@dataclasses.dataclass(frozen=True)
class Sailing:
    """What a survey is sailed with, and how it is cut."""

    settings: simulation.Settings
    vehicle: vehicle.Settings
    ground: seabed.Random
    length_m: float
    spacing_m: float


def prepared(params: Path, plan: Plan, more: int = 0) -> Sailing:
    """Return what a survey is sailed with; `more` is for others of its kind, with other ground and drift."""
    settings = parameters.read(params, f"simulate.{plan.like}", simulation.Settings)
    line, scale = study.survey(params, plan.like), plan.scale
    layout = dataclasses.replace(
        settings.layout,
        **{key: scale * getattr(settings.layout, key) for key in ("line_length_m", "start_jitter_m", "repeat_m")},
        line_spacing_m=scale * min(settings.layout.line_spacing_m, placed.WIDEST_M),
    )
    settings = dataclasses.replace(
        settings,
        seed=SEEDS + 10_000 * plan.seed + more,
        layout=layout,
        **{key: scale * getattr(settings, key) for key in ("altitude_m", "ping_spacing_m", "beam_spacing_m")},
    )
    sailing = parameters.read(params, f"vehicles.{settings.vehicle}", vehicle.Settings)
    if settings.terrain is None:
        raise SystemExit(f"{plan.like} has no terrain; leave it out")
    easting, northing = settings.centre_m
    ground = seabed.Random(plan.terrain(settings.terrain), settings.seed, settings.crs, (easting, northing))
    return Sailing(settings, sailing, ground, scale * line.submap_length_m, round(scale * line.point_spacing_m, 1))


def sail(params: Path, name: str, plan: Plan) -> Track:
    """Return a survey, cut into submaps."""
    made = prepared(params, plan)
    lines = list(simulation.survey(made.settings, made.vehicle, made.ground))
    cut = [submap for line in lines for submap in stretches(line, made.length_m, made.spacing_m)]
    clouds, navigation, truth, times = zip(*cut, strict=True)
    start = lines[0].truth.iloc[0]
    fix = drift.Fix(*(float(start[key]) for key in ("time_s", "x_m", "y_m")))
    rates = parameters.read(params, "navigation", dict[str, drift.Settings])["simulated"]
    number, poses, true = np.arange(len(clouds)), np.array(navigation), np.array(truth)
    return Track(name, number, list(clouds), poses, true, np.array(times), fix, rates, made.spacing_m)


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


def summary(rows: pd.DataFrame) -> list[Row]:
    """Return a row for each survey and method: stage close's numbers."""
    return [
        {"survey": name, "method": method, **values}
        for name, methods in numbers.summarise(rows).items()
        for method, values in methods.items()
    ]


def pooled(rows: pd.DataFrame) -> list[Row]:
    """Return a row for each method over all surveys, and the p-value that map's SE(2) error is below its."""
    everywhere = summary(rows.assign(survey="all", run=rows.groupby(["survey", "run"]).ngroup()))
    first = rows[rows["believed"] == rows["believed"].iloc[0]]
    se2 = first.set_index(["survey", "run", "method"])["se2_m"].unstack()
    for row in everywhere:
        method = row["method"]
        rival = method in se2 and method != catalogue.MAP
        row["p"] = intervals.p_below(*_differences(se2[catalogue.MAP] - se2[method])) if rival else None
    return everywhere


def _differences(values: pd.Series) -> tuple[np.ndarray, np.ndarray]:
    known = values.dropna()
    return known.to_numpy(), known.index.get_level_values("survey").to_numpy()


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    names = list(SURVEYS)
    parser.add_argument(
        "--surveys", nargs="+", default=names, choices=names, metavar="SURVEY", help="which of the twelve"
    )
    parser.add_argument("--drifts", type=int, default=3, help="drawn besides the one sailed")
    parser.add_argument("--believed", type=float, nargs="+", default=[1.0, 3.0], help="factors of the drift's sigmas")
    parser.add_argument("--runs", type=int, default=200, help="registrations of each label")
    parser.add_argument("--model", type=Path, help="a trained network to compare with")
    parser.add_argument("--wrong", type=float, nargs="*", default=[], help="shares of closures that get wrong ends")
    parser.add_argument("--rows", type=Path, help="CSV of every run to write")
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    return parser


if __name__ == "__main__":
    command.run(main, options())
