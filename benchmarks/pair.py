"""Milliseconds of one loop closure: MAP registration with its covariances, against GICP's kernel, one core each.

Source and target are two passes over the same simulated ground, prepared beforehand; both lie where they truly do, and
every registration begins elsewhere. GICP and MAP take turns from the same starts, in one process. `map_ms` is the
registration and one more pass over the matches; `pair_ms` has K, Q and V as well, and is what `ratio` compares with
`gicp_ms`. Errors are quoted beside: noise is of every coordinate, and there is no drift inside a pass.
"""
# ruff: noqa: E402

import os

for library in ("OPENBLAS", "MKL", "NUMBA", "OMP"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import argparse
import dataclasses
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

import submaps
from pointnetkl.methods import runtime
from pointnetkl.registration import gicp, monte_carlo, pair
from pointnetkl.registration.pair import covariance, factor
from pointnetkl.reporting import text_table
from pointnetkl.surveys.se2 import SE2
from pointnetkl.workflow import command, parameters

NUMBERS, GATES = covariance.Settings(), factor.Settings()
COLUMNS = (
    *("submap", "slope", "gicp_ms", "map_ms", "covariance_ms", "pair_ms", "ratio", "factor_ms", "gicp_end_ms"),
    *("gicp_iterations", "map_iterations", "gicp_rms_m", "map_rms_m", "map_nees", "rank"),
    *("gicp_yaw_ms", "pair_yaw_ms"),
)

Row = dict[str, Any]


class Closure:
    """Two passes over one ground, and what is registered from many starts."""

    def __init__(self, ground: submaps.Ground, label: monte_carlo.Settings, registration: gicp.Settings, seed: int):
        """Prepare both passes, and register once, so that all is compiled and loaded.

        Raises:
            GicpError: a pass cannot be registered.
        """
        rng = np.random.default_rng([seed, 2])
        noisy = ground.points + rng.normal(0, label.noise_sigma_m, ground.points.shape)
        first = rng.permutation(len(noisy)) < len(noisy) // 2
        self._pair = gicp.prepare(noisy[first], registration), gicp.prepare(noisy[~first], registration)
        self._spacing_m = ground.spacing_m
        self._sigmas = monte_carlo.prior_sigmas(label, 3)
        self._settings = {
            dof: pair.Settings.of(dataclasses.replace(registration, dof=dof), "map") for dof in ("xy", "xyyaw")
        }
        self.repeat(1, [seed])

    def repeat(self, runs: int, seed: list[int]) -> Row:
        """Register from so many new starts by each method; return milliseconds and errors of one."""
        starts = np.random.default_rng(seed).normal(0, self._sigmas[:2], (runs, 2))
        row: Row = {}
        # who comes first changes, because a processor slows down as it gets warm
        for method in [self._gicp, self._map][:: 1 if seed[-1] % 2 else -1]:
            row |= method([SE2(start, 0.0) for start in starts])
        return row | {"ratio": row["pair_ms"] / row["gicp_ms"]}

    def _gicp(self, starts: list[SE2]) -> Row:
        settings = self._settings["xy"]
        ends, ms = timed(lambda start: gicp.register(*self._pair, settings, start), starts)
        block_m = NUMBERS.block_spacings * self._spacing_m
        _, end_ms = timed(lambda end: pair.at(*self._pair, end.T_target_source, block_m, settings, in_plane=True), ends)
        _, yaw_ms = timed(lambda start: gicp.register(*self._pair, self._settings["xyyaw"], start), starts)
        return {
            "gicp_ms": ms,
            "gicp_end_ms": end_ms,
            "gicp_yaw_ms": yaw_ms,
            "gicp_iterations": float(np.mean([end.iterations for end in ends])),
            "gicp_square_m2": float(np.mean([np.sum(end.T_target_source.translation**2) for end in ends])),
        }

    def _map(self, starts: list[SE2]) -> Row:
        ends, ms = timed(lambda start: self._register("xy", start), starts)
        covariances, covariance_ms = timed(lambda end: self._covariances("xy", end), ends)
        factors, factor_ms = timed(lambda end: factor.of(end.forces, NUMBERS, GATES), ends)
        _, yaw_ms = timed(lambda start: self._covariances("xyyaw", self._register("xyyaw", start)), starts)
        errors = [end.T_target_source.translation for end in ends]
        return {
            "map_ms": ms,
            "covariance_ms": covariance_ms,
            "pair_ms": ms + covariance_ms,
            "factor_ms": factor_ms,
            "pair_yaw_ms": yaw_ms,
            "map_iterations": float(np.mean([end.iterations for end in ends])),
            "map_square_m2": float(np.mean([error @ error for error in errors])),
            "map_nees": float(
                np.mean(
                    [error @ np.linalg.solve(Q, error) / 2 for error, (Q, _) in zip(errors, covariances, strict=True)]
                )
            ),
            "rank": float(np.mean([len(each.c) for each in factors])),
        }

    def _prior(self, dof: str) -> np.ndarray:
        return np.diag(self._sigmas[: self._settings[dof].dimensions] ** 2)

    def _register(self, dof: str, start: SE2) -> pair.Estimate:
        return pair.register(*self._pair, self._prior(dof), self._spacing_m, self._settings[dof], start)

    def _covariances(self, dof: str, end: pair.Estimate) -> tuple[np.ndarray, np.ndarray]:
        K, lever_m = covariance.information(end.forces, NUMBERS), end.forces.lever_m
        return (
            covariance.with_prior(K, self._prior(dof), lever_m, NUMBERS),
            covariance.without_prior(K, lever_m, NUMBERS),
        )


def timed(function: Callable[[Any], Any], arguments: list[Any]) -> tuple[list[Any], float]:
    """Return a function's answers, and the milliseconds of one."""
    begun = time.perf_counter()
    answers = [function(argument) for argument in arguments]
    return answers, 1e3 * (time.perf_counter() - begun) / len(arguments)


def main(arguments: argparse.Namespace) -> None:
    """Time both methods on every submap, in turns, and print a table; with --json a line of JSON after it."""
    if arguments.repetitions < 1 or arguments.runs < 1:
        raise submaps.BenchmarkError(
            f"--runs is {arguments.runs} and --repetitions {arguments.repetitions}; there must be at least 1 of each"
        )
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    grounds = submaps.chosen(arguments.params, arguments.terrain, arguments.points, arguments.seed, passes=2)
    closures = {name: Closure(ground, label, registration, arguments.seed) for name, ground in grounds.items()}
    turns = [(repetition, name) for repetition in range(arguments.repetitions) for name in closures]
    table = pd.DataFrame(
        {"submap": name, "slope": grounds[name].slope}
        | closures[name].repeat(arguments.runs, [arguments.seed, repetition])
        for repetition, name in tqdm(turns, desc="pair", unit="turn", dynamic_ncols=True)
    )
    rows = [{"submap": name} | summary(table[table["submap"] == name]) for name in closures]
    total = summary(table) | {f"{name}_largest": max(row[name] for row in rows) for name in ("pair_ms", "ratio")}
    print(text_table.markdown([text_table.block("Medians over the repetitions", rows, list(COLUMNS))]))
    if arguments.json:
        asked = {name: value for name, value in vars(arguments).items() if name not in ("params", "json")}
        print(json.dumps(text_table.rounded(asked | total | {"submaps": rows, "machine": runtime.machine()})))


def summary(table: pd.DataFrame) -> Row:
    """Return medians over the repetitions, and the root mean square of the errors."""
    row = {str(name): float(value) for name, value in table.drop(columns="submap").median().items()}
    for name in ("gicp", "map"):
        row[f"{name}_rms_m"] = float(np.sqrt(table[f"{name}_square_m2"].mean()))
        del row[f"{name}_square_m2"]
    return row


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    parser.add_argument("--points", type=int, default=submaps.POINTS, help="of each pass")
    parser.add_argument("--runs", type=int, default=40, help="registrations of each submap in a repetition")
    parser.add_argument("--repetitions", type=int, default=5, help="medians are over these")
    terrains = ["all", *submaps.TERRAINS]
    parser.add_argument("--terrain", choices=terrains, default="all", help="ground of the submap from either survey")
    parser.add_argument("--seed", type=int, default=1, help="of submaps, noise and starts")
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    return parser


if __name__ == "__main__":
    command.run(main, options())
