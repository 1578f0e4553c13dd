"""Read a raw survey of any supported format into pings and soundings in a local map frame."""

import argparse
from pathlib import Path

from pointnetkl import readers
from pointnetkl.surveys import survey
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Read the raw files and the truth; write pings, soundings and truth in one map frame."""
    how = parameters.read(arguments.params, "ingest", readers.Settings)
    with artifacts.TableWriter(arguments.out / "soundings.parquet", survey.SOUNDINGS) as soundings:
        found = readers.read(arguments.raw, how, soundings.write, arguments.out)
        truth = readers.read_truth(arguments.truth, found)
        soundings.metadata = {
            "survey": arguments.survey,
            "kind": found.kind,
            "crs": found.crs,
            "origin": list(found.origin),
            "report": found.report,
            "params": parameters.as_metadata(how),
        }
    for name, table, schema in (("pings", found.pings, survey.PINGS), ("truth", truth, survey.TRAJECTORY)):
        artifacts.write_table(arguments.out / f"{name}.parquet", table, schema, soundings.metadata)
    print(f"{arguments.survey}: {survey.summary(found)}")


if __name__ == "__main__":
    parser = command.parser(__doc__ or "")
    parser.add_argument("survey", metavar="SURVEY", help="the survey's name in study.surveys")
    parser.add_argument("--raw", type=Path, required=True, help="raw file, or folder of raw files")
    parser.add_argument("--truth", type=Path, required=True, help="true trajectory; data/none says unknown")
    parser.add_argument("--out", type=Path, required=True, help="folder to write the tables to")
    command.run(main, parser)
