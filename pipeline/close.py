"""Close a survey from its own navigation, with every method's covariance of the loop closures (Table V).

Tiles of points have no track: their tables have no rows. Where the truth is not known, errors are null.
"""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.registration import gicp, pair
from pointnetkl.registration.covariance import table
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.closing import comparison, drift, schemas
from pointnetkl.slam.closing.comparison import Covariances, Track
from pointnetkl.slam.graph import graph_file
from pointnetkl.surveys import submap, survey
from pointnetkl.workflow import artifacts, command, parameters, study


def main(arguments: argparse.Namespace) -> None:
    """Read submaps, the graph's poses and the covariances; write errors, closed poses and closures."""
    name = arguments.survey
    settings = parameters.read(arguments.params, "close", comparison.Settings)
    stated = parameters.read(arguments.params, "navigation", dict[str, drift.Settings])
    artifacts.require_survey(name, arguments.submaps, arguments.poses, arguments.pings)
    _, graph, _ = graph_file.read(arguments.graph, name)
    navigation = study.survey(arguments.params, name).navigation
    rates = drift.named(navigation, stated, f"study.surveys.{name}.navigation")
    print(f"{name}: drifts as {navigation} (study.surveys.{name}.navigation)")
    # headings are held by navigation: a turn of a submap by its matches would hardly move the map
    gicp_settings = parameters.read(arguments.params, "registration", gicp.Settings)
    registration = pair.Settings.of(dataclasses.replace(gicp_settings, dof="xy"), "map")
    results = comparison.none()
    if graph.track:
        track = read_track(arguments, graph.truth, rates)
        rivals = read_rivals(arguments, track)
        results = comparison.compare(track, rivals, settings, registration)
    frame = artifacts.table_metadata(arguments.pings)
    metadata: dict[str, Any] = {"survey": name, **{key: frame.get(key) for key in ("crs", "origin")}} | {
        section: parameters.as_metadata(values)
        for section, values in (("close", settings), ("drift", rates), ("registration", registration))
    }
    artifacts.write_table(arguments.rows, results.rows, schemas.ROWS, metadata)
    artifacts.write_table(arguments.closed, results.poses, schemas.POSES, metadata)
    artifacts.write_table(arguments.closures, results.closures, schemas.CLOSURES, metadata)


def read_track(arguments: argparse.Namespace, truth: np.ndarray, rates: drift.Settings) -> Track:
    """Return the survey's submaps in the order of the track, with their poses by navigation."""
    sampling = submap.read_sampling(arguments.submaps)
    if sampling.kind == survey.SUBMAPS:
        print(f"{arguments.survey}: submaps without times are taken for a second apart: only distance makes drift grow")
    submaps = submap.from_table(arguments.survey, artifacts.read_table(arguments.submaps, submap.POINTS))
    poses = artifacts.read_table(arguments.poses, submap.POSES).sort_values("submap", ignore_index=True)
    first = artifacts.read_table(arguments.pings, survey.PINGS).iloc[0]
    return Track(
        survey=arguments.survey,
        number=np.array([s.number for s in submaps]),
        clouds=[s.points for s in submaps],
        navigation=submap.poses_from_table(poses),
        truth=truth,
        time_s=poses["time_s"].to_numpy(),
        fix=drift.Fix(*(float(first[column]) for column in ("time_s", "x_m", "y_m"))),
        drift=rates,
        spacing_m=sampling.spacing_m,
    )


def read_rivals(arguments: argparse.Namespace, track: Track) -> Covariances:
    """Return the rivals' covariances of x and y, by method, for every submap."""
    rows = table.read((arguments.estimated, arguments.predicted, arguments.measured), arguments.survey)
    by_method = protocol.by_method(rows[rows["method"].isin(comparison.RIVALS)])
    unknown = np.full((2, 2), np.nan)
    return {
        method: np.array([by_method[method].get(number, unknown)[:2, :2] for number in track.number.tolist()])
        for method in comparison.RIVALS
        if method in by_method
    }


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="name of the survey")
    parser.add_argument("--submaps", type=Path, required=True, help="points of its submaps")
    parser.add_argument("--poses", type=Path, required=True, help="their poses by navigation")
    parser.add_argument("--pings", type=Path, required=True, help="its pings: navigation is right at the first")
    parser.add_argument("--graph", type=Path, required=True, help="its graph, which has the true poses")
    parser.add_argument("--estimated", type=Path, required=True, help="covariances that need only the submap")
    parser.add_argument("--predicted", type=Path, required=True, help="covariances by learned methods")
    parser.add_argument("--measured", type=Path, required=True, help="covariances measured on loop closures")
    parser.add_argument("--rows", type=Path, required=True, help="table of errors to write")
    parser.add_argument("--closed", type=Path, required=True, help="table of the closed poses to write")
    parser.add_argument("--closures", type=Path, required=True, help="table of its loop closures to write")
    command.run(main, parser)
