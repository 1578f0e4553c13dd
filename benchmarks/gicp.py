"""Milliseconds per registration of a Monte Carlo label: this project's GICP against small_gicp's, one core each.

Both register the same noisy, moved copies of the same simulated submaps back, in turns, in one process. Of ours, all
that a label pays per registration is timed: drawing the noise, moving the copy, its normals, aligning it. small_gicp
gets its copies for nothing; timed are its covariances (k-d tree, 20 neighbours) and aligning. "Prepared" takes ours'
normals and small_gicp's covariances, each timed alone, out of the time. small_gicp has no planar mode: it moves the
copy in all six degrees of freedom, and its x and y are those of the submap's centre.
"""
# ruff: noqa: E402

import os

# before NumPy and numba are imported, which read these once; small_gicp is told its threads by argument, and Open3D,
# which OMP is for, gets all cores
for library, threads in (("OPENBLAS", 1), ("MKL", 1), ("NUMBA", 1), ("OMP", os.cpu_count() or 1)):
    os.environ[f"{library}_NUM_THREADS"] = str(threads)

import argparse
import importlib.metadata
import json
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

import peers
import submaps
from contest import Contest, Row
from pointnetkl.methods import runtime
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance.gaussian import KL_FLOOR_M2
from pointnetkl.reporting import text_table
from pointnetkl.workflow import command, parameters

LABEL_RUNS = 3000  # of the paper: what preparing a submap is shared out over
PACKAGES = ("numpy", "numba", "small_gicp", "open3d", "open3d-cpu")
COLUMNS = (
    *("submap", "ours_ms", "small_gicp_ms", "ratio", "ours_prepared_ms", "small_gicp_prepared_ms", "ratio_prepared"),
    *("ours_iterations", "small_gicp_iterations", "kl", "kl_floor0"),
    *("ours_yaw_ms", "kl_yaw", "kl_yaw_floor0", "open3d_ms"),
)


def main(arguments: argparse.Namespace) -> None:
    """Time every engine on every submap, in turns, and print a table; with --json a line of JSON after it."""
    check(arguments)
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    grounds = submaps.chosen(arguments.params, arguments.terrain, arguments.points, arguments.seed)
    contests = {name: Contest(ground, label, registration, arguments.open3d) for name, ground in grounds.items()}
    table = race(contests, arguments)
    rows = [of_submap(name, ground, contests[name], table) for name, ground in grounds.items()]
    total = in_all(table, rows)
    show(rows, total, label, registration)
    if arguments.json:
        asked = {name: value for name, value in vars(arguments).items() if name not in ("params", "json")}
        print(json.dumps(text_table.rounded(total | asked | {"submaps": rows} | machine())))


def check(arguments: argparse.Namespace) -> None:
    """Refuse numbers that leave nothing to measure.

    Raises:
        BenchmarkError: there is no repetition, or there are fewer than 3 runs in it.
    """
    if arguments.repetitions < 1 or arguments.runs < 3:
        raise submaps.BenchmarkError(
            f"--runs is {arguments.runs} and --repetitions {arguments.repetitions}; there must be at least 3 and 1"
        )


def race(contests: dict[str, Contest], arguments: argparse.Namespace) -> pd.DataFrame:
    """Return a row per repetition and submap; all the submaps take part before the next repetition begins."""
    turns = [(repetition, name) for repetition in range(arguments.repetitions) for name in contests]
    rows = [
        {"submap": name, "repetition": repetition}
        | contests[name].repeat(arguments.runs, [arguments.seed, 1, repetition])
        for repetition, name in tqdm(turns, desc="gicp", unit="turn", dynamic_ncols=True)
    ]
    return pd.DataFrame(rows)


def of_submap(name: str, ground: submaps.Ground, contest: Contest, table: pd.DataFrame) -> Row:
    """Return a submap's medians over the repetitions, and how far apart the two covariances are, in nats."""
    described = {"submap": name, "spacing_m": ground.spacing_m, "slope": ground.slope}
    kl = {
        f"kl{dof}{tail}": contest.kl(f"ours{dof}", floor_m2)
        for dof in ("", "_yaw")
        for tail, floor_m2 in (("", KL_FLOOR_M2), ("_floor0", 0.0))
    }
    return described | medians(table[table["submap"] == name].drop(columns="submap")) | kl


def in_all(table: pd.DataFrame, rows: list[Row]) -> Row:
    """Return the medians over the repetitions of the mean over the submaps, the mean KL, and the least ratios."""
    total = medians(table.drop(columns="submap").groupby("repetition", as_index=False).mean())
    total["ours_prepare_amortised_ms"] = total["ours_prepare_once_ms"] / LABEL_RUNS
    # flat submaps take many iterations, which are what ours saves most on: the mean leans on them
    for name in ("ratio", "ratio_prepared"):
        total[f"{name}_least"] = min(row[name] for row in rows)
    for name in ("kl", "kl_floor0", "kl_yaw", "kl_yaw_floor0"):
        total[name.replace("kl", "kl_between_covariances", 1)] = float(np.mean([row[name] for row in rows]))
    return total


def medians(table: pd.DataFrame) -> Row:
    """Return the medians over the repetitions, one a row, and the least and greatest of what is judged."""
    # a ratio is taken within a repetition, so that a machine that slows down between two slows both sides
    ratios = {
        "ratio": table["small_gicp_ms"] / table["ours_ms"],
        "ratio_prepared": table["small_gicp_prepared_ms"] / table["ours_prepared_ms"],
        "noise_share": table["noise_ms"] / table["ours_ms"],
    }
    table = table.drop(columns="repetition").assign(**ratios)
    ranged = ("ours_ms", "small_gicp_ms", "ratio", "ratio_prepared")
    ranges = {f"{name}_range": [float(table[name].min()), float(table[name].max())] for name in ranged}
    return {str(name): float(value) for name, value in table.median().items()} | ranges


def show(rows: list[Row], total: Row, label: monte_carlo.Settings, registration: gicp.Settings) -> None:
    """Print a table of the submaps and their mean, and what was compared."""
    mean = {name.replace("kl_between_covariances", "kl"): value for name, value in total.items()} | {"submap": "mean"}
    rows = [{name: _ranged(row, name) for name in row} for row in [*rows, mean]]
    names = [name for name in COLUMNS if name in rows[0]]
    print(text_table.markdown([text_table.block("Medians over the repetitions (least to greatest)", rows, names)]))
    print(
        f"One registration: a copy moved by N(0, {label.prior_variance_m2:g} m^2) in x and y, with noise of"
        f" {label.noise_sigma_m:g} m, onto its submap; matches within {registration.max_distance_m:g} m, at most"
        f" {registration.max_iterations} iterations. Ours moves in x and y and stops at a step under"
        f" {registration.tolerance_m:g} m, small_gicp moves in all six degrees of freedom and stops at one under"
        f" {registration.tolerance_m:g} m and {peers.ROTATION_TOLERANCE_RAD:.2g} rad; kl is KL(ours || small_gicp) of"
        f" the two covariances of x and y with {KL_FLOOR_M2:g} m^2 added to both, kl_floor0 without.\n"
        f"The ratio is {total['ratio_least']:.3g} or more on each submap, {total['ratio_prepared_least']:.3g} prepared."
        f" Drawing the noise is {total['noise_share']:.0%} of ours at most (drawn again, apart); preparing a submap,"
        f" once, takes {total['ours_prepare_once_ms']:.3g} ms, or {total['ours_prepare_amortised_ms']:.2g} ms for each"
        f" of {LABEL_RUNS} registrations (small_gicp: {total['small_gicp_prepare_once_ms']:.3g} ms once).\n"
        f"Busy cores: ours {total['ours_cores']:.2f}, small_gicp {total['small_gicp_cores']:.2f}"
        + (f", Open3D {total['open3d_cores']:.2f}" if "open3d_cores" in total else "")
    )


def _ranged(row: Row, name: str) -> Any:
    if f"{name}_range" not in row:
        return row[name]
    low, high = (text_table.cell(value, 3) for value in row[f"{name}_range"])
    return f"{text_table.cell(row[name], 3)} ({low} to {high})"


def machine() -> Row:
    """Return the processor and the versions that the numbers depend on."""
    installed = {each.name: each.version for each in importlib.metadata.distributions() if each.name in PACKAGES}
    return {"versions": installed, "machine": runtime.machine()}


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    parser.add_argument("--points", type=int, default=submaps.POINTS, help="of each submap")
    parser.add_argument("--runs", type=int, default=60, help="registrations of each submap in a repetition")
    parser.add_argument("--repetitions", type=int, default=5, help="medians are over these")
    terrains = ["all", *submaps.TERRAINS]
    parser.add_argument("--terrain", choices=terrains, default="all", help="ground of the submap from either survey")
    parser.add_argument("--seed", type=int, default=1, help="of submaps, moves and noise")
    parser.add_argument("--open3d", action="store_true", help="also time Open3D's GICP, which takes all cores")
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    return parser


if __name__ == "__main__":
    command.run(main, options())
