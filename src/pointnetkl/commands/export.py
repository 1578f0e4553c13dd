"""Command `export`: writes a graph of the pipeline as g2o and TUM files."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pointnetkl.commands import shared
from pointnetkl.registration.covariance import catalogue

if TYPE_CHECKING:
    from pointnetkl.slam.graph.survey_graph import SurveyGraph

_DESCRIPTION = """\
Write a survey's graph as a g2o file for other programs: the graph that stage `slam` optimises with the covariances of
one method.

Vertices are submaps by their numbers; the first one is held (FIX). Their poses are those of "GT": navigation optimised
with the Monte Carlo covariances. Edges are dead reckoning between neighbours, taken from GT, and the loop closures of
the graph's first draw, from the earlier submap to the later one. --corrupted N adds the yaw noise of repetition N to
dead reckoning, and writes the poses that follow from it, where the benchmark starts.
"""


def add(commands: Any) -> None:
    """Add the command's parser."""
    command = shared.parser(
        commands, "export", "write a survey's graph as g2o and TUM files", _DESCRIPTION, shared.DIALECTS_HELP
    )
    command.add_argument("graph", type=Path, metavar="GRAPH.npz", help="a graph that stage `graph` made")
    command.add_argument(
        "--covariances", type=Path, nargs="+", required=True, metavar="TABLE", help="covariances of the survey"
    )
    command.add_argument(
        "--method", default=catalogue.NETWORK, help="method to take covariances of (default: %(default)s)"
    )
    command.add_argument(
        "--edges", choices=shared.EDGES, help="how to count edges (default: slam.edges of the parameters)"
    )
    command.add_argument("--corrupted", type=int, metavar="N", help="add the noise of this repetition, from 0")
    command.add_argument(
        "--dialect", choices=shared.DIALECTS, default="g2o", help="of the file to write (default: %(default)s)"
    )
    command.add_argument("--params", type=Path, default=Path("params.yaml"), help="parameters (default: %(default)s)")
    command.add_argument("--out", type=Path, required=True, metavar="GRAPH.g2o", help="graph to write")
    command.add_argument("--tum", type=Path, metavar="FILE", help="trajectory to write, with the same poses")
    command.add_argument(
        "--poses", type=Path, metavar="TABLE", help="poses that stage `segment` made, for the trajectory's times"
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the files and print the counts of submaps and edges."""
    # these imports take seconds, and --help does not need them
    from pointnetkl.exchange import g2o, graph_exchange, tum
    from pointnetkl.slam.benchmark import protocol
    from pointnetkl.slam.graph import graph_file, pose_graph, survey_graph
    from pointnetkl.workflow import parameters

    shared.require_apart(arguments.out, arguments.tum)
    settings = parameters.read(arguments.params, "slam", protocol.Settings)
    survey = graph_file.read(arguments.graph).graph
    if not survey.track:
        raise shared.CommandError(f"{arguments.graph}: its points have no track, so it has no edges to export")
    q = shared.covariances(arguments.covariances, arguments.method, settings.floor_m2, survey.survey)
    poses, dead_reckoning = survey.gt, pose_graph.between(survey.gt)
    if arguments.corrupted is not None:
        if arguments.corrupted < 0:
            raise shared.CommandError(f"--corrupted is {arguments.corrupted}, must be 0 or above")
        dead_reckoning = protocol.corrupt(survey, 0, arguments.corrupted, settings)
        poses = pose_graph.chain(survey.gt[0], dead_reckoning)
    origin, edges = f"{survey.survey}, {arguments.method}", arguments.edges or settings.edges
    full = survey_graph.full_covariances(survey.number, q, survey.closures, survey.closure_noise, origin, edges)
    noise, closures = survey.dead_reckoning_noise, survey.closures.edges
    graph = graph_exchange.join(survey.number, poses, dead_reckoning, noise, closures, full)
    times, times_are = _times(arguments.poses, survey)
    g2o.write(arguments.out, graph, arguments.dialect)
    if arguments.tum:
        tum.write(arguments.tum, times, poses, times_are)
    counts = f"{len(dead_reckoning)} edges of dead reckoning, {len(full)} loop closures"
    print(f"{survey.survey}: {len(poses)} submaps, {counts}")
    return 0


def _times(path: Path | None, survey: "SurveyGraph") -> tuple[np.ndarray, str]:
    """Return each submap's time (n,), and its meaning: seconds where a table of poses is given, else its number."""
    from pointnetkl.surveys import submap
    from pointnetkl.workflow import artifacts

    if path is None:
        return survey.number.astype(np.float64), "a submap's number stands for its time"
    artifacts.require_survey(survey.survey, path)
    time_s = artifacts.read_table(path, submap.POSES).set_index("submap")["time_s"]
    if missing := [number for number in survey.number.tolist() if number not in time_s.index]:
        raise shared.CommandError(f"{path}: has no submap {missing[0]}; give the poses of the graph's survey")
    return time_s.loc[survey.number].to_numpy(np.float64), "seconds"
