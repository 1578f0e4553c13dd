"""Read a raw survey of any supported format into pings and soundings in a local map frame."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path
from typing import Any

from pointnetkl import readers
from pointnetkl.surveys import survey
from pointnetkl.workflow import artifacts, command, parameters
from pointnetkl.workflow.table_writer import TableWriter


def main(arguments: argparse.Namespace) -> None:
    """Read the raw files and the true trajectory; write pings, soundings and truth in one map frame."""
    settings = parameters.read(arguments.params, "ingest", readers.Settings)
    with TableWriter(arguments.out / "soundings.parquet", survey.SOUNDINGS) as soundings:
        raw_survey = readers.read(arguments.raw, settings, soundings.write, arguments.out)
        truth = readers.read_truth(arguments.truth, raw_survey)
        soundings.metadata = {
            "survey": arguments.survey,
            "kind": raw_survey.kind,
            "crs": raw_survey.crs,
            "origin": list(raw_survey.origin),
            "report": raw_survey.report,
            "params": parameters.as_metadata(settings),
        }
    artifacts.write_table(arguments.out / "pings.parquet", raw_survey.pings, survey.PINGS, soundings.metadata)
    metadata = {**soundings.metadata, **simulated(arguments.truth)}
    artifacts.write_table(arguments.out / "truth.parquet", truth, survey.TRAJECTORY, metadata)
    print(f"{arguments.survey}: {survey.summary(raw_survey)}")


def simulated(truth: Path) -> dict[str, Any]:
    """Return what a simulated survey's truth says that it was simulated with, for the report."""
    metadata = {} if artifacts.is_none(truth) else artifacts.table_metadata(truth)
    return {key: value for key, value in metadata.items() if key == "simulate"}


if __name__ == "__main__":
    parser = command.parser(__doc__ or "")
    parser.add_argument("survey", metavar="SURVEY", help="the survey's name in study.surveys")
    parser.add_argument("--raw", type=Path, required=True, help="a raw file, or a folder of raw files")
    parser.add_argument("--truth", type=Path, required=True, help="the true trajectory, or data/none if it is unknown")
    parser.add_argument("--out", type=Path, required=True, help="folder to write the tables to")
    command.run(main, parser)
