"""The same answer: our kernel against the slow reference, on the same draws, over ground flat to rugged.

Both run until a step is under 1e-6 m (at most 200). Printed for each submap are the share of runs that end within 1 mm
of each other and the divergence of the two covariances; runs that end farther apart are listed, each with the reason
found. "Production" is our kernel as the labels stop it (params.yaml: registration) against itself run to 1e-6 m.
"""
# ruff: noqa: E402

import os

for library in ("OPENBLAS", "MKL", "NUMBA", "OMP"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import argparse
import dataclasses
import json
import time
from collections import Counter
from typing import Any

import numpy as np
from tqdm import tqdm

import submaps
from divergence import NEAR_M, Apart, Pair
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian
from pointnetkl.registration.covariance.gaussian import KL_FLOOR_M2
from pointnetkl.reporting import text_table
from pointnetkl.workflow import command, parameters

KL_GOAL = 1e-3
LISTED = 40  # runs apart that are looked into

Row = dict[str, Any]


def main(arguments: argparse.Namespace) -> None:
    """Compare on every submap, print the table and the runs apart; with --json a line of JSON after them."""
    check(arguments)
    begun = time.perf_counter()
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    production = parameters.read(arguments.params, "registration", gicp.Settings)
    rows: list[Row] = []
    apart: list[Row] = []
    for ground in tqdm(grounds(arguments), desc="agreement", unit="submap", dynamic_ncols=True):
        row, far = compare(ground, len(rows), arguments, label, production, LISTED - len(apart))
        rows.append(row)
        apart += [{"submap": row["submap"]} | dataclasses.asdict(each) for each in far]
    total = in_all(rows, apart) | {"seconds": time.perf_counter() - begun}
    show(rows, apart, total)
    if arguments.json:
        asked = {name: value for name, value in vars(arguments).items() if name not in ("params", "json")}
        print(json.dumps(text_table.rounded(total | asked | {"submaps": rows, "apart": apart})))


def check(arguments: argparse.Namespace) -> None:
    """Refuse numbers that leave nothing to compare.

    Raises:
        BenchmarkError: there are fewer than 2 submaps, 3 runs, or production runs than runs.
    """
    if arguments.submaps < 2 or not 3 <= arguments.runs <= arguments.production_runs:
        raise submaps.BenchmarkError(
            f"--submaps is {arguments.submaps}, --runs {arguments.runs} and --production-runs"
            f" {arguments.production_runs}; there must be 2 submaps, 3 runs, and no fewer production runs than runs"
        )


def grounds(arguments: argparse.Namespace) -> list[submaps.Ground]:
    """Return the submaps: half of them from each survey, flattest first."""
    half = arguments.submaps // 2
    return [
        ground
        for survey in submaps.SURVEYS
        for ground in submaps.ladder(arguments.params, survey, half, arguments.points, arguments.seed)
    ]


def compare(
    ground: submaps.Ground,
    number: int,
    arguments: argparse.Namespace,
    label: monte_carlo.Settings,
    production: gicp.Settings,
    listed: int,
) -> tuple[Row, list[Apart]]:
    """Return one submap's row, and at most `listed` of its runs that end apart."""
    fine = dataclasses.replace(production, tolerance_m=1e-6, max_iterations=200)
    halves = (ground.points, ground.points) if arguments.copy == "same" else (ground.points[::2], ground.points[1::2])
    pair = Pair(*halves, fine)
    rng = np.random.default_rng([arguments.seed, 2, number])
    noise = gicp.Noise(label.noise_sigma_m, key=int(rng.integers(1 << 63)))
    moves = rng.standard_normal((arguments.production_runs, 2)) * np.sqrt(label.prior_variance_m2)
    ours, stopped = pair.ours(moves, noise, fine), pair.ours(moves, noise, production)
    runs = arguments.runs
    theirs, converged = pair.by_reference(moves[:runs], noise)
    distance = np.linalg.norm(ours.T_target_copy.translation[:runs] - theirs, axis=1)
    far = np.flatnonzero(distance >= NEAR_M)[: max(listed, 0)]
    early = np.linalg.norm(ours.T_target_copy.translation - stopped.T_target_copy.translation, axis=1)
    row = {
        "submap": f"{ground.survey} {number}",
        "slope": ground.slope,
        "runs": runs,
        "within_1mm": float(np.mean(distance < NEAR_M)),
        "median_mm": 1e3 * float(np.median(distance)),
        "largest_mm": 1e3 * float(distance.max()),
        **_kl("kl", moves[:runs], ours.T_target_copy.translation[:runs], theirs),
        "converged": float(ours.converged[:runs].mean()),
        "reference_converged": float(converged.mean()),
        "iterations": float(ours.iterations.mean()),
        "production_within_1mm": float(np.mean(early < NEAR_M)),
        "production_largest_mm": 1e3 * float(early.max()),
        **_kl("production_kl", moves, ours.T_target_copy.translation, stopped.T_target_copy.translation),
        "production_iterations": float(stopped.iterations.mean()),
    }
    return row, [pair.explain(moves[i], dataclasses.replace(noise, first=int(i)), theirs[i]) for i in far]


def _kl(name: str, moves: np.ndarray, ours: np.ndarray, theirs: np.ndarray) -> Row:
    p, q = (monte_carlo.covariance(moves + found) for found in (ours, theirs))
    floored = gaussian.kl_divergence(gaussian.with_floor(p, KL_FLOOR_M2), gaussian.with_floor(q, KL_FLOOR_M2))
    return {name: float(floored), f"{name}_floor0": float(gaussian.kl_divergence(p, q))}


def in_all(rows: list[Row], apart: list[Row]) -> Row:
    """Return what the goals are judged by, and what stopping early changes."""
    share, runs = (np.array([row[name] for row in rows]) for name in ("within_1mm", "runs"))
    return {
        "share_within_1mm": float(np.average(share, weights=runs)),
        "runs_compared": int(runs.sum()),
        "runs_apart": round(float(np.sum((1 - share) * runs))),
        "why_apart": dict(Counter(each["why"] for each in apart)),
        "kl_largest": max(row["kl"] for row in rows),
        "kl_largest_floor0": max(row["kl_floor0"] for row in rows),
        "submaps_within_kl_goal": sum(row["kl_floor0"] < KL_GOAL for row in rows),
        "production_kl_largest": max(row["production_kl"] for row in rows),
        "production_kl_median": float(np.median([row["production_kl"] for row in rows])),
        "production_share_within_1mm": float(np.mean([row["production_within_1mm"] for row in rows])),
    }


def show(rows: list[Row], apart: list[Row], total: Row) -> None:
    """Print the tables and the verdict."""
    blocks = [text_table.block("Submaps, flattest of each survey first", rows, list(rows[0]))]
    if apart:
        blocks.append(text_table.block(f"Runs that end {NEAR_M:g} m or more apart", apart, list(apart[0])))
    print(text_table.markdown(blocks))
    reasons = ", ".join(f"{count} {why}" for why, count in total["why_apart"].items())
    print(
        f"{total['share_within_1mm']:.4%} of {total['runs_compared']} runs end within 1 mm of the reference"
        f" (goal 99 %); {total['runs_apart']} do not{': ' * bool(reasons)}{reasons}.\n"
        f"KL of the covariances without a floor is at most {total['kl_largest_floor0']:.2g} nats, under {KL_GOAL:g}"
        f" on {total['submaps_within_kl_goal']} of {len(rows)} submaps ({total['kl_largest']:.2g} with"
        f" {KL_FLOOR_M2:g} m^2).\n"
        f"Stopped as in production, {total['production_share_within_1mm']:.2%} of runs are where they would end; KL is"
        f" at most {total['production_kl_largest']:.2g}, median {total['production_kl_median']:.2g}.\n"
        f"{total['seconds']:.0f} s."
    )


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    parser.add_argument("--points", type=int, default=submaps.POINTS, help="of each submap")
    parser.add_argument("--submaps", type=int, default=30, help="half of them from each survey")
    parser.add_argument(
        "--runs", type=int, default=80, help="registrations of each submap by both; the reference is slow"
    )
    parser.add_argument(
        "--production-runs", type=int, default=300, help="of each submap by ours alone, the same and more"
    )
    copies = "same: the submap's points, moved; split: every other point, onto the rest"
    parser.add_argument("--copy", choices=["same", "split"], default="same", help=copies)
    parser.add_argument("--seed", type=int, default=1, help="of submaps, moves and noise")
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    return parser


if __name__ == "__main__":
    command.run(main, options())
