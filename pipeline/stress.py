"""Optimise a survey's graph with wrong loop closures among the true, by robust estimators."""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl import artifacts, command, settings, submap
from pointnetkl.covariance import table
from pointnetkl.slam import false_closures, loop_gate, protocol, stress, survey_graph


def main(arguments: argparse.Namespace) -> None:
    """Read the graph, the submaps and the covariances; write errors by kernel, share and method, and the gate's."""
    name = arguments.survey
    chosen = settings.read(arguments.params, "stress", stress.Settings)
    arrays, made_with = artifacts.read_arrays(arguments.graph)
    graph = survey_graph.from_arrays(arrays)
    paths = (arguments.estimated, arguments.predicted)
    tables = [artifacts.read_table(path, table.SCHEMA, also=table.YAW) for path in paths]
    methods = stress.chosen(protocol.by_method(pd.concat(tables, ignore_index=True), chosen.floor_m2), chosen, name)
    submaps = submap.from_table(name, artifacts.read_table(arguments.submaps, submap.POINTS))
    clouds = protocol.clouds_of(graph, {s.number: s.points for s in submaps})
    known = bool(np.isfinite(graph.truth).all())
    cell = made_with["graph"]["cell_factor"] * made_with["spacing_m"]
    apart = false_closures.pairs_apart(loop_gate.coverages(clouds, graph.truth if known else graph.gt, cell))
    rows = stress.benchmark(stress.Case(graph, methods, apart, chosen))
    corrupted = [stress.corrupted_poses(graph, i, chosen) for i in range(chosen.repetitions)]
    gate = loop_gate.table(graph, clouds, corrupted, cell, made_with["graph"]["coverage"])
    metadata = {"survey": name, "stress": settings.as_metadata(chosen), "graph": made_with}
    artifacts.write_table(arguments.rows, rows, stress.ROWS, metadata)
    artifacts.write_table(arguments.gate, gate, loop_gate.GATE, metadata)


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
