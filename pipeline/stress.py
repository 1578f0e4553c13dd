"""Optimise a survey's graph with false loop closures among the true ones, by robust estimators."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pointnetkl.registration.covariance import table
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.graph import graph_file
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.slam.robust import false_closures, loop_gate, schemas, stress
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Read the graph, the submaps and the covariances; write errors by kernel, and the loop gate's counts."""
    name = arguments.survey
    settings = parameters.read(arguments.params, "stress", stress.Settings)
    slam_settings = parameters.read(arguments.params, "slam", protocol.Settings)
    file = graph_file.read(arguments.graph, name)
    artifacts.require_survey(name, arguments.submaps)
    spacing = submap.read_sampling(arguments.submaps).spacing_m
    cell, coverage = file.number("graph.cell_factor") * spacing, file.number("graph.coverage")
    covariances = table.read((arguments.estimated, arguments.predicted), name)
    methods = stress.select_methods(protocol.by_method(covariances, slam_settings.floor_m2), settings, name)
    submaps = submap.from_table(name, artifacts.read_table(arguments.submaps, submap.POINTS))
    clouds = protocol.node_clouds(file.graph, {s.number: s.points for s in submaps})
    rows, gate = (schema.empty_table().to_pandas() for schema in (schemas.ROWS, schemas.GATE))
    if file.graph.track:  # without one there is nothing to optimise
        pairs = pairs_apart(file.graph, clouds, cell)
        experiment = stress.Experiment(file.graph, methods, pairs, slam_settings.yaw_sigma_rad, settings)
        rows = stress.benchmark(experiment)
        corrupted = [stress.corrupted_poses(experiment, i) for i in range(settings.repetitions)]
        gate = loop_gate.table(file.graph, clouds, corrupted, cell, coverage)
    metadata = {
        "survey": name,
        "stress": parameters.as_metadata(settings),
        "slam": {"yaw_sigma_rad": slam_settings.yaw_sigma_rad, "floor_m2": slam_settings.floor_m2},
        "graph": file.metadata,
    }
    artifacts.write_table(arguments.rows, rows, schemas.ROWS, metadata)
    artifacts.write_table(arguments.gate, gate, schemas.GATE, metadata)


def pairs_apart(graph: SurveyGraph, clouds: Sequence[np.ndarray], cell: float) -> np.ndarray:
    """Return the pairs (p, 2) of nodes that do not overlap at the true poses (at GT where the truth is not known)."""
    has_truth = bool(np.isfinite(graph.truth).all())
    return false_closures.pairs_apart(loop_gate.coverages(clouds, graph.truth if has_truth else graph.gt, cell))


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="name of the survey")
    parser.add_argument("--graph", type=Path, required=True, help="its graph")
    parser.add_argument("--submaps", type=Path, required=True, help="points of its submaps")
    parser.add_argument("--estimated", type=Path, required=True, help="covariances that need only the submap")
    parser.add_argument("--predicted", type=Path, required=True, help="covariances by learned methods")
    parser.add_argument("--rows", type=Path, required=True, help="table of errors to write")
    parser.add_argument("--gate", type=Path, required=True, help="table of the loop gate to write")
    command.run(main, parser)
