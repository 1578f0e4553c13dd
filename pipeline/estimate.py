"""Covariances of a survey's submaps by the methods that need only the submap, its labels or a few registrations."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path

from pointnetkl.methods import estimated
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import label_table, method, table
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Write the survey's covariance table."""
    settings = parameters.read(arguments.params, "estimate", estimated.Settings)
    origin = artifacts.table_metadata(arguments.labels)
    label = parameters.from_metadata(origin, "label", monte_carlo.Settings, arguments.labels)
    registration = parameters.from_metadata(origin, "registration", gicp.Settings, arguments.labels)
    artifacts.require_survey(arguments.survey, arguments.submaps, arguments.labels)
    submaps = submap.from_table(arguments.survey, artifacts.read_table(arguments.submaps, submap.POINTS))
    labels = artifacts.read_table(arguments.labels, label_table.schema(registration.dimensions))
    covariances = method.tabulate(estimated.methods(labels, settings, label, registration), submaps)
    sections = {"estimate": settings, "label": label, "registration": registration}
    params = {section: parameters.as_metadata(values) for section, values in sections.items()}
    metadata = {"survey": arguments.survey, "params": params}
    artifacts.write_table(arguments.covariances, covariances, table.schema(registration.dimensions), metadata)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="the survey's name in study.surveys")
    parser.add_argument("--submaps", type=Path, required=True)
    parser.add_argument("--labels", type=Path, required=True)
    parser.add_argument("--covariances", type=Path, required=True)
    command.run(main, parser)
