"""Build a survey's pose graph: GT from navigation, then draws of the loop closures of Algorithm 1.

Tiles of points have no track. Their graph has no edges, and the stages after it write tables without rows.
"""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path

from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import label_table
from pointnetkl.slam.closures import graph_construction, loop_closure
from pointnetkl.slam.graph import survey_graph
from pointnetkl.surveys import submap, survey
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Read submaps, poses, labels and truth; write the graph, with its settings and a summary as metadata."""
    name = arguments.survey
    settings = parameters.read(arguments.params, "graph", loop_closure.Settings)
    registration_settings = parameters.read(arguments.params, "registration", gicp.Settings)
    tables = (arguments.submaps, arguments.poses, arguments.labels, arguments.pings, arguments.truth)
    artifacts.require_survey(name, *tables)
    submaps = submap.from_table(name, artifacts.read_table(arguments.submaps, submap.POINTS))
    poses = artifacts.read_table(arguments.poses, submap.POSES).sort_values("submap", ignore_index=True)
    labels = artifacts.read_table(arguments.labels, label_table.schema(registration_settings.dimensions))
    q = graph_construction.label_covariances(labels, name)
    navigation, sampling = submap.poses_from_table(poses), submap.read_sampling(arguments.submaps)
    spacing = sampling.spacing_m
    if sampling.kind == survey.POINTS:  # tiles, which have no track
        graph = graph_construction.without_track(name, submaps, navigation, spacing, settings, registration_settings)
    else:
        pings = artifacts.read_table(arguments.pings, survey.PINGS)
        truth = graph_construction.true_poses(poses, pings, artifacts.read_table(arguments.truth, survey.TRAJECTORY))
        graph = graph_construction.build(name, submaps, navigation, truth, q, spacing, settings, registration_settings)
    metadata = {
        "survey": name,
        "spacing_m": spacing,
        "graph": parameters.as_metadata(settings),
        "registration": parameters.as_metadata(registration_settings),
        "summary": survey_graph.summary(graph),
    }
    artifacts.write_arrays(arguments.graph, survey_graph.to_arrays(graph), metadata)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="name of the survey")
    parser.add_argument("--submaps", type=Path, required=True, help="points of its submaps")
    parser.add_argument("--poses", type=Path, required=True, help="their poses by navigation")
    parser.add_argument("--labels", type=Path, required=True, help="their Monte Carlo covariances")
    parser.add_argument(
        "--pings", type=Path, required=True, help="the vehicle's navigation, for the error of its heading"
    )
    parser.add_argument("--truth", type=Path, required=True, help="true trajectory; without rows where it is not known")
    parser.add_argument("--graph", type=Path, required=True, help="graph to write")
    command.run(main, parser)
