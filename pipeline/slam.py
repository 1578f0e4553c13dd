"""Optimise a survey's corrupted graphs many times, with the covariances of every method."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import table
from pointnetkl.slam.benchmark import benchmark as slam_benchmark
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.benchmark import schemas as slam_schemas
from pointnetkl.slam.consistency import consistency_map, map_to_map
from pointnetkl.slam.consistency import schemas as consistency_schemas
from pointnetkl.slam.consistency.consistency_map import Cells
from pointnetkl.slam.consistency.map_to_map import MapToMap
from pointnetkl.slam.consistency.map_to_map_auvlib import MapToMapAuvlib
from pointnetkl.slam.graph import graph_file
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, parameters


class Results(NamedTuple):
    """The content of the stage's outputs."""

    rows: pd.DataFrame
    trajectories: pd.DataFrame
    cells: Mapping[str, Cells]
    thinned: pd.DataFrame


def main(arguments: argparse.Namespace) -> None:
    """Read the graph and the covariances; write the errors of every run, and trajectories and maps of the first."""
    name = arguments.survey
    settings = parameters.read(arguments.params, "slam", protocol.Settings)
    _, graph, graph_metadata = graph_file.read(arguments.graph, name)
    artifacts.require_survey(name, arguments.submaps, arguments.pings)
    covariances = table.read((arguments.estimated, arguments.predicted, arguments.measured), name)
    methods = protocol.by_method(covariances, settings.floor_m2)
    submaps = submap.from_table(name, artifacts.read_table(arguments.submaps, submap.POINTS))
    results = run_benchmark(graph, methods, submaps, settings) if graph.track else without_track()
    for sentence in slam_benchmark.unsolved(results.rows):
        print(sentence, file=sys.stderr)
    metadata = {"survey": name, "slam": parameters.as_metadata(settings), "graph": graph_metadata}
    artifacts.write_table(arguments.rows, results.rows, slam_schemas.ROWS, metadata)
    artifacts.write_table(arguments.trajectories, results.trajectories, slam_schemas.TRAJECTORIES, metadata)
    frame = consistency_map.Frame(*consistency_map.read_origin(arguments.pings), settings.map_cell_m)
    consistency_map.write(arguments.consistency, results.cells, frame, metadata)
    artifacts.write_table(arguments.map_thinning, results.thinned, consistency_schemas.THINNING, metadata)


def run_benchmark(
    graph: SurveyGraph, methods: protocol.Methods, submaps: Iterable[submap.Submap], settings: protocol.Settings
) -> Results:
    """Return the benchmark's tables, and the errors of its maps."""
    clouds = protocol.node_clouds(graph, {s.number: s.points for s in submaps})
    measure = MapToMap(clouds, settings.map_cell_m, settings.map_thinning)
    map_errors = {"map_to_map_m": measure, "map_to_map_auvlib_m": MapToMapAuvlib(clouds, settings.seed)}
    rows, trajectories = slam_benchmark.benchmark(graph, methods, map_errors, settings)
    cells = consistency_map.cells_by_trajectory(trajectories, measure.cells)
    thinned = map_to_map.thinning_table(graph.survey, clouds, graph.gt, settings.map_cell_m)
    return Results(rows, trajectories, cells, thinned)


def without_track() -> Results:
    """Return the results for a graph without a track: tables without rows, and a map without cells."""
    schemas = (slam_schemas.ROWS, slam_schemas.TRAJECTORIES, consistency_schemas.THINNING)
    rows, trajectories, thinned = (schema.empty_table().to_pandas() for schema in schemas)
    # a band in name only, because a raster has at least one
    return Results(rows, trajectories, {"no track": Cells(*np.empty((3, 0), np.int64))}, thinned)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="name of the survey")
    parser.add_argument("--graph", type=Path, required=True, help="its graph")
    parser.add_argument("--submaps", type=Path, required=True, help="points of its submaps")
    parser.add_argument("--estimated", type=Path, required=True, help="covariances that need only the submap")
    parser.add_argument("--predicted", type=Path, required=True, help="covariances by learned methods")
    parser.add_argument("--measured", type=Path, required=True, help="covariances of its loop closures")
    parser.add_argument("--pings", type=Path, required=True, help="its pings, which say where its map frame lies")
    parser.add_argument("--rows", type=Path, required=True, help="table of errors to write")
    parser.add_argument("--trajectories", type=Path, required=True, help="table of trajectories to write")
    parser.add_argument("--consistency", type=Path, required=True, help="GeoTIFF to write, a band a trajectory")
    parser.add_argument("--map-thinning", type=Path, required=True, help="table of map-to-map errors to write")
    command.run(main, parser)
