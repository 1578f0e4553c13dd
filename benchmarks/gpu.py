"""Registrations per second on an NVIDIA GPU, and whether its answers are the CPU's, over ground flat to rugged.

Three things are measured on submaps of both test surveys. The kernel: one launch of many runs, the clouds already on
the GPU. All of it: submaps as a label takes them, each prepared, sent, registered --runs times and its errors fetched,
by as many threads as there are cores. The CPU's answer to the first --checked runs of each submap: the same draws.
Without a GPU it ends in one sentence.
"""
# ruff: noqa: E402

import os

# before NumPy is imported, which reads these once: every core has a thread of its own
for library in ("OPENBLAS", "MKL", "NUMBA", "OMP"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import argparse
import json
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from tqdm import tqdm

import submaps
from pointnetkl.methods import runtime
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian
from pointnetkl.registration.gicp import registration
from pointnetkl.registration.gicp.cuda import engine as cuda
from pointnetkl.reporting import text_table
from pointnetkl.workflow import command, parameters

POINTS = 6553  # of the paper's mean submap
PAPER_SUBMAPS, PAPER_RUNS, GOAL_S = 9080, 3000, 120.0
NEAR_M = 1e-3

Row = dict[str, Any]


class Bench:
    """Submaps, and how they are registered."""

    def __init__(self, arguments: argparse.Namespace):
        """Draw the submaps."""
        self.label = parameters.read(arguments.params, "label", monte_carlo.Settings)
        self.registration = parameters.read(arguments.params, "registration", gicp.Settings)
        self.grounds = submaps.chosen(arguments.params, arguments.terrain, arguments.points, arguments.seed)
        self._seed = arguments.seed

    def prepare(self, name: str) -> gicp.Cloud:
        """Prepare a submap, as every label has to."""
        return gicp.prepare(self.grounds[name].points, self.registration)

    def draws(self, name: str, runs: int) -> tuple[np.ndarray, gicp.Noise]:
        """Return the moves (runs, 2) of a submap's copies, and their noise."""
        rng = np.random.default_rng([self._seed, list(self.grounds).index(name)])
        noise = gicp.Noise(self.label.noise_sigma_m, key=int(rng.integers(1 << 63)))
        return rng.standard_normal((runs, 2)) * np.sqrt(self.label.prior_variance_m2), noise

    def register(self, name: str, runs: int, engine: str) -> gicp.Registrations:
        """Prepare a submap and register copies of it onto it."""
        cloud = self.prepare(name)
        return gicp.register_noisy(cloud, cloud, *self.draws(name, runs), self.registration, engine=engine)


def main(arguments: argparse.Namespace) -> None:
    """Check and measure, print a table, and end in one line of JSON."""
    check(arguments)
    cuda.require_gpu()
    bench = Bench(arguments)
    rows = [of_submap(bench, name, arguments) for name in tqdm(bench.grounds, desc="gpu", unit="submap")]
    rate, seconds = all_of_it(bench, arguments)
    total = in_all(rows, rate, arguments)
    print(text_table.markdown([text_table.block("Submaps, flattest of each survey first", rows, list(rows[0]))]))
    print(verdict(total, seconds, arguments))
    print(json.dumps(text_table.rounded(machine() | total | {"submaps": rows})))


def check(arguments: argparse.Namespace) -> None:
    """Refuse numbers that leave nothing to measure.

    Raises:
        BenchmarkError: there are fewer than 3 runs to check, or nothing is launched.
    """
    if arguments.checked < 3 or min(arguments.runs, arguments.launched, arguments.labels, arguments.threads) < 1:
        raise submaps.BenchmarkError(
            f"--checked is {arguments.checked}, --runs {arguments.runs}, --launched {arguments.launched}, --labels"
            f" {arguments.labels} and --threads {arguments.threads}; there must be 3 to check, and 1 of the others"
        )


def of_submap(bench: Bench, name: str, arguments: argparse.Namespace) -> Row:
    """Return one submap's agreement with the CPU, and the kernel's rate on it."""
    here, there = (bench.register(name, arguments.checked, engine) for engine in ("cpu", "cuda"))
    apart = np.linalg.norm(here.T_target_copy.translation - there.T_target_copy.translation, axis=1)
    moves, _ = bench.draws(name, arguments.checked)
    p, q = (monte_carlo.covariance(moves + found.T_target_copy.translation) for found in (here, there))
    seconds, iterations = kernel_alone(bench, name, arguments)
    return {
        "submap": name,
        "slope": bench.grounds[name].slope,
        "iterations": iterations,
        "within_1mm": float(np.mean(apart < NEAR_M)),
        "largest_mm": 1e3 * float(apart.max()),
        "same_iterations": float(np.mean(here.iterations == there.iterations)),
        "kl_floor0": float(gaussian.kl_divergence(p, q)),
        "kernel_us": 1e6 * seconds / arguments.launched,
    }


def kernel_alone(bench: Bench, name: str, arguments: argparse.Namespace) -> tuple[float, float]:
    """Return the seconds of one launch, the median of several, and the mean iterations of its runs."""
    lane, cloud, limits = cuda.Lane(), bench.prepare(name), registration.limits(bench.registration)
    moves, noise = bench.draws(name, arguments.launched)
    seconds = []
    for _ in range(arguments.repetitions + 1):  # the first compiles, and wakes the GPU up
        given = cuda.arguments(lane, cloud, cloud, moves, noise, limits)
        begun = time.perf_counter()
        _, iterations, _ = cuda.launch(lane, given)
        seconds.append(time.perf_counter() - begun)
    return float(np.median(seconds[1:])), float(iterations.mean())


def all_of_it(bench: Bench, arguments: argparse.Namespace) -> tuple[float, float]:
    """Return registrations per second from the points of a submap to its errors, and the seconds that it took."""
    names = list(bench.grounds)
    turns = [names[i % len(names)] for i in range(arguments.labels)]
    begun = time.perf_counter()
    with ThreadPoolExecutor(arguments.threads) as threads:
        done = threads.map(lambda name: len(bench.register(name, arguments.runs, "cuda").iterations), turns)
        registrations = sum(tqdm(done, desc="labels", total=len(turns), unit="submap"))
    seconds = time.perf_counter() - begun
    return registrations / seconds, seconds


def in_all(rows: list[Row], rate: float, arguments: argparse.Namespace) -> Row:
    """Return what the goals are judged by."""
    kernel_us = float(np.mean([row["kernel_us"] for row in rows]))
    work = PAPER_SUBMAPS * PAPER_RUNS
    return {
        "points": arguments.points,
        "share_within_1mm": float(np.mean([row["within_1mm"] for row in rows])),
        "kl_largest_floor0": max(row["kl_floor0"] for row in rows),
        "kernel_per_s": 1e6 / kernel_us,
        "all_per_s": rate,
        "paper_kernel_s": work * kernel_us / 1e6,
        "paper_all_s": work / rate,
        "threads": arguments.threads,
    }


def verdict(total: Row, seconds: float, arguments: argparse.Namespace) -> str:
    """Return what was found, in words."""
    return (
        f"{total['share_within_1mm']:.3%} of runs end within 1 mm of the CPU's; KL of the covariances without a floor"
        f" is at most {total['kl_largest_floor0']:.2g}.\n"
        f"{total['kernel_per_s']:.0f} registrations/s by the kernel, {total['all_per_s']:.0f} with preparing by"
        f" {arguments.threads} threads ({arguments.labels} submaps in {seconds:.1f} s).\n"
        f"{PAPER_SUBMAPS} x {PAPER_RUNS} at {arguments.points} points: {total['paper_kernel_s']:.0f} s of the kernel,"
        f" {total['paper_all_s']:.0f} s with preparing (goal {GOAL_S:.0f} s)."
    )


def machine() -> Row:
    """Return what was measured on."""
    return {"gpu": cuda.Lane().gpu, **runtime.machine()}


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    parser.add_argument("--points", type=int, default=POINTS, help="of each submap")
    parser.add_argument("--terrain", choices=["all", *submaps.TERRAINS], default="all", help="of each survey")
    parser.add_argument("--checked", type=int, default=300, help="runs of each submap by both engines")
    parser.add_argument("--launched", type=int, default=30_000, help="runs of one launch, to time the kernel alone")
    parser.add_argument("--repetitions", type=int, default=5, help="launches timed")
    parser.add_argument("--runs", type=int, default=PAPER_RUNS, help="of each submap, to time all of it")
    parser.add_argument("--labels", type=int, default=200, help="submaps, to time all of it")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="that prepare and launch")
    parser.add_argument("--seed", type=int, default=1, help="of submaps, moves and noise")
    return parser


if __name__ == "__main__":
    command.run(main, options())
