"""Measure the errors of a survey's loop closures, and covariances of them, to check the labels of single submaps."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path

import pandas as pd

from pointnetkl.models import trained
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import table
from pointnetkl.registration.pair import covariance
from pointnetkl.slam.closures import errors as closure_errors
from pointnetkl.slam.closures import loop_closure, overlap, schemas
from pointnetkl.slam.graph import graph_file
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Read the graph and its submaps; write the errors of its registrations, and tables of covariances."""
    name = arguments.survey
    settings = parameters.read(arguments.params, "calibrate", closure_errors.Settings)
    label_settings = parameters.read(arguments.params, "label", monte_carlo.Settings)
    file = graph_file.read(arguments.graph, name)
    graph_settings = parameters.from_metadata(file.metadata, "graph", loop_closure.Settings, file.path)
    registration_settings = parameters.from_metadata(file.metadata, "registration", gicp.Settings, file.path)
    artifacts.require_survey(name, arguments.submaps)
    submaps = submap.from_table(name, artifacts.read_table(arguments.submaps, submap.POINTS))
    spacing = submap.read_sampling(arguments.submaps).spacing_m
    numbers = parameters.read(arguments.params, "close.closing.search.numbers", covariance.Settings)
    setup = closure_errors.Setup(spacing, graph_settings, label_settings, registration_settings, numbers)
    measured = closure_errors.measure(file.graph, submaps, settings, setup)
    models = trained.load_all([arguments.model], label_settings, registration_settings)
    predicted = overlap.tabulate(models, file.graph, submaps, setup.reach_m)
    covariances = pd.concat([measured.covariances, predicted], ignore_index=True)
    sections = {"calibrate": settings, "label": label_settings, "numbers": numbers}
    metadata = {"survey": name, "graph": file.metadata}
    metadata |= {section: parameters.as_metadata(values) for section, values in sections.items()}
    dimensions = registration_settings.dimensions
    artifacts.write_table(arguments.closures, measured.rows, schemas.schema(dimensions), metadata)
    artifacts.write_table(arguments.covariances, covariances, table.schema(dimensions), metadata)
    artifacts.write_table(arguments.ends, measured.ends, schemas.ends_schema(dimensions), metadata)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="name of the survey")
    parser.add_argument("--graph", type=Path, required=True, help="its graph")
    parser.add_argument("--submaps", type=Path, required=True, help="points of its submaps")
    parser.add_argument(
        "--model", type=Path, required=True, help="model to ask about the common ground of loop closures"
    )
    parser.add_argument("--closures", type=Path, required=True, help="table of its loop closures' errors to write")
    parser.add_argument("--covariances", type=Path, required=True, help="table of covariances to write")
    parser.add_argument(
        "--ends", type=Path, required=True, help="table to write, of errors and covariances of single registrations"
    )
    command.run(main, parser)
