"""Simulate a survey: raw pings as a sonar would log them, a file for each line, and the true trajectory."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path

import pandas as pd

from pointnetkl import simulation
from pointnetkl.simulation import vehicle
from pointnetkl.surveys.survey import TRAJECTORY
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Write one Parquet file for each line, and the truth."""
    settings = parameters.read(arguments.params, f"simulate.{arguments.survey}", simulation.Settings)
    vehicle_settings = parameters.read(arguments.params, f"vehicles.{settings.vehicle}", vehicle.Settings)
    terrain = simulation.ground(settings)
    metadata = {"survey": arguments.survey, "simulate": parameters.as_metadata(settings)}
    metadata["vehicle"] = parameters.as_metadata(vehicle_settings)
    for stale in arguments.raw.glob("line_*.parquet"):  # files of an earlier run with more lines
        stale.unlink()
    truth = []
    for number, line in enumerate(simulation.survey(settings, vehicle_settings, terrain)):
        path = arguments.raw / f"line_{number:03d}.parquet"
        artifacts.write_table(path, line.raw, simulation.RAW, metadata, crs=terrain.crs)
        truth.append(line.truth)
    artifacts.write_table(arguments.truth, pd.concat(truth), TRAJECTORY, metadata, crs=terrain.crs)


if __name__ == "__main__":
    parser = command.parser(__doc__ or "")
    parser.add_argument("survey", help="an entry of section `simulate`")
    parser.add_argument("--raw", type=Path, required=True, help="folder for the raw pings")
    parser.add_argument("--truth", type=Path, required=True, help="file for the true trajectory")
    command.run(main, parser)
