"""What a second local worker gains: the label stage itself, on submaps of the paper's size, with one worker and two.

Each repetition runs the stage's script twice, in turns, from its command line to its last line, on shards of its own.
"start" is the same with 3 registrations a label: what a user waits for besides them, the workers' start among it.
Efficiency is the time with one worker over `workers` times the time with that many; without start, both times are less
that.
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

import submaps
from pointnetkl.reporting import text_table
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command

SURVEY = "borno_8"
FEWEST_RUNS = 3  # of a label that is no singular matrix
ROOT = Path(__file__).resolve().parent.parent


def main(arguments: argparse.Namespace) -> None:
    """Time the stage with one worker and with more, print the medians; with --json a line of JSON after them."""
    if min(arguments.submaps, arguments.repetitions) < 1 or arguments.runs < 3 or arguments.workers < 2:
        raise submaps.BenchmarkError("--submaps and --repetitions must be at least 1, --runs 3 and --workers 2")
    with survey(arguments) as folder:
        label(folder, 1)  # compiles what is not compiled yet
        rows = [
            {str(count): label(folder, count) for count in (1, arguments.workers)} for _ in range(arguments.repetitions)
        ]
        start = {str(count): label(folder, count, "start.yaml") for count in (1, arguments.workers)}
    print(text_table.markdown([text_table.block("Seconds by workers", [*rows, start], list(start))]))
    found = efficiencies(rows, start, arguments.workers)
    print(
        f"{arguments.submaps} submaps of {arguments.points} points, {arguments.runs} registrations each, the last line"
        f" with {FEWEST_RUNS}: efficiency with {arguments.workers} workers {found['efficiency']:.1%},"
        f" {found['efficiency_without_start']:.1%} without start"
    )
    if arguments.json:
        print(json.dumps(text_table.rounded(found)))


@contextlib.contextmanager
def survey(arguments: argparse.Namespace) -> Iterator[Path]:
    """Yield a folder with the submaps to label, rugged and typical ones in turns, and their parameters."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ladder = submaps.ladder(arguments.params, SURVEY, arguments.submaps, arguments.points, arguments.seed)
        table = submap.to_table(submap.Submap(SURVEY, i, g.points, g.points, g.points) for i, g in enumerate(ladder))
        artifacts.write_table(folder / "submaps.parquet", table, submap.POINTS, {})
        params = yaml.safe_load(arguments.params.read_text())
        params["study"]["surveys"] = {SURVEY: params["study"]["surveys"][SURVEY]}
        params["label"]["held_out_runs"] = 0
        for name, runs in (("params.yaml", arguments.runs), ("start.yaml", FEWEST_RUNS)):
            params["study"]["surveys"][SURVEY]["label_runs"] = runs
            (folder / name).write_text(yaml.safe_dump(params))
        yield folder


def label(folder: Path, workers: int, params: str = "params.yaml") -> float:
    """Return the seconds that the label stage takes with no label there."""
    shards = folder / f"shards_{time.monotonic_ns()}"
    paths = {"params": params, "submaps": "submaps.parquet", "labels": "labels.parquet", "errors": "errors.npz"}
    options = [f"--{option}={folder / name}" for option, name in paths.items()]
    environment = os.environ | {"POINTNETKL_WORKERS": str(workers)}
    script = [sys.executable, str(ROOT / "pipeline/label.py"), SURVEY, f"--shards={shards}", *options]
    begun = time.perf_counter()
    done = subprocess.run(script, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise submaps.BenchmarkError(f"the label stage failed: {done.stderr.strip().splitlines()[-1]}")
    return time.perf_counter() - begun


def efficiencies(rows: list[dict[str, float]], start: dict[str, float], workers: int) -> dict[str, Any]:
    """Return the medians over the repetitions of the efficiency, with and without start, and of the seconds."""
    one, many = "1", str(workers)
    return {
        "workers": workers,
        "efficiency": statistics.median(row[one] / (workers * row[many]) for row in rows),
        "efficiency_without_start": statistics.median(
            (row[one] - start[one]) / (workers * (row[many] - start[many])) for row in rows
        ),
        "seconds_one": statistics.median(row[one] for row in rows),
        "seconds_many": statistics.median(row[many] for row in rows),
        "start_one_s": start[one],
        "start_many_s": start[many],
    }


def options() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = command.parser(__doc__ or "")
    parser.add_argument("--submaps", type=int, default=24, help="to label")
    parser.add_argument("--points", type=int, default=submaps.POINTS, help="of each submap")
    parser.add_argument("--runs", type=int, default=3000, help="registrations of each submap")
    parser.add_argument("--workers", type=int, default=2, help="to compare with one")
    parser.add_argument("--repetitions", type=int, default=3, help="medians are over these")
    parser.add_argument("--seed", type=int, default=1, help="of the submaps")
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    return parser


if __name__ == "__main__":
    command.run(main, options())
