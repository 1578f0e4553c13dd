"""The errors of a survey's loop closures, and covariances measured on them: is what a label says of one submap true?"""

import argparse
from pathlib import Path

import pandas as pd

from pointnetkl.models import trained
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import table
from pointnetkl.slam.closures import errors as closure_errors
from pointnetkl.slam.closures import loop_closure, overlap, tables
from pointnetkl.slam.graph import graph_file
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Read the graph and its submaps; write a row per registration, and a table of covariances."""
    name = arguments.survey
    chosen = parameters.read(arguments.params, "calibrate", closure_errors.Settings)
    graph = parameters.read(arguments.params, "graph", loop_closure.Settings)
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    file = graph_file.read(arguments.graph, name, registration.dimensions)
    made, made_with = file.graph, file.made_with
    artifacts.require_survey(name, arguments.submaps)
    submaps = submap.from_table(name, artifacts.read_table(arguments.submaps, submap.POINTS))
    how = closure_errors.How(submap.read_sampling(arguments.submaps).spacing_m, graph, label, registration)
    rows, measured = closure_errors.measure(made, submaps, chosen, how)
    models = trained.load_all([arguments.model], label, registration)
    reach = None if graph.overlap_factor is None else graph.overlap_factor * how.spacing_m
    covariances = pd.concat([measured, overlap.tabulate(models, made, submaps, reach)], ignore_index=True)
    metadata = {"survey": name, "calibrate": parameters.as_metadata(chosen), "graph": made_with}
    dimensions = registration.dimensions
    artifacts.write_table(arguments.closures, rows, tables.schema(dimensions), metadata)
    artifacts.write_table(arguments.covariances, covariances, table.schema(dimensions), metadata)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="name of the survey")
    parser.add_argument("--graph", type=Path, required=True, help="its graph")
    parser.add_argument("--submaps", type=Path, required=True, help="points of its submaps")
    parser.add_argument("--model", type=Path, required=True, help="that is asked about the ground in common")
    parser.add_argument("--closures", type=Path, required=True, help="table of its loop closures' errors to write")
    parser.add_argument("--covariances", type=Path, required=True, help="table of covariances to write")
    command.run(main, parser)
