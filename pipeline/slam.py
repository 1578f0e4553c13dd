"""Optimise a survey's corrupted graph with every method's covariances, many times."""

import argparse
from pathlib import Path

import pandas as pd

from pointnetkl import artifacts, command, map_to_map, settings, slam, submap, survey_graph
from pointnetkl.covariance import table


def main(arguments: argparse.Namespace) -> None:
    """Read the graph and the covariances; write errors by method and repetition, and trajectories."""
    name = arguments.survey
    chosen = settings.read(arguments.params, "slam", slam.Settings)
    arrays, made_with = artifacts.read_arrays(arguments.graph)
    graph = survey_graph.from_arrays(arrays)
    paths = (arguments.estimated, arguments.predicted)
    tables = [artifacts.read_table(path, table.SCHEMA, also=table.YAW) for path in paths]
    methods = slam.by_method(pd.concat(tables, ignore_index=True))
    submaps = submap.from_table(name, artifacts.read_table(arguments.submaps, submap.POINTS))
    clouds = slam.clouds_of(graph, {s.number: s.points for s in submaps})
    map_error = map_to_map.MapToMap(clouds, chosen.map_cell_m, chosen.map_thinning)
    rows, trajectories = slam.benchmark(graph, methods, map_error, chosen)
    metadata = {"survey": name, "slam": settings.as_metadata(chosen), "graph": made_with}
    artifacts.write_table(arguments.rows, rows, slam.ROWS, metadata)
    artifacts.write_table(arguments.trajectories, trajectories, slam.TRAJECTORIES, metadata)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="name of the survey")
    parser.add_argument("--graph", type=Path, required=True, help="its graph")
    parser.add_argument("--submaps", type=Path, required=True, help="points of its submaps")
    parser.add_argument("--estimated", type=Path, required=True, help="covariances that need only the submap")
    parser.add_argument("--predicted", type=Path, required=True, help="covariances by learned methods")
    parser.add_argument("--rows", type=Path, required=True, help="table of errors to write")
    parser.add_argument("--trajectories", type=Path, required=True, help="table of trajectories to write")
    command.run(main, parser)
