"""Command `solve`: optimises a user's pose graph, with our covariances on its loop closures if wanted."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pointnetkl.commands import shared
from pointnetkl.registration.covariance import catalogue
from pointnetkl.slam.robust import schemas

if TYPE_CHECKING:
    from pointnetkl.exchange.g2o import Graph
    from pointnetkl.exchange.graph_solver import Solution

_KERNELS = ("none", *schemas.KERNELS[1:])
_DESCRIPTION = """\
Find the most likely poses of a pose graph in a g2o file (3D: VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX), by GTSAM's
Levenberg-Marquardt from the poses in the file. Vertices with a line FIX are held; without such a line the first is.

--covariances replaces the covariance in x and y (and yaw, where the tables have it) of every loop closure: an edge
between vertices i and j with |i - j| > 1. A vertex must have its submap's number. The edge gets the covariance Q of the
later submap, which counts as the registered one. Q is in that submap's levelled frame; where the submap is the edge's
first vertex, Q is moved to the frame of the second, where g2o and GTSAM have an edge's error. Variances of z, roll,
pitch (and yaw) stay as they are; their correlations with x and y become zero. Q is used as the tables have it. `export`
adds a floor (slam.floor_m2 of the parameters); `solve` does not. Every edge of a submap gets its full Q, as with
`export --edges all`.

--robust lowers the weights of loop closures that contradict the rest, and lists those with a weight of a half or less;
other edges are trusted. The weight depends on the length of a closure's residual at the solution, whitened by its
covariance. With the default thresholds (stress.thresholds of the parameters) it is a half at 1.0 (cauchy), 1.35 (dcs)
and 2.69 (huber), and gnc drops a closure at 4.1.
"""


def add(commands: Any) -> None:
    """Add the command's parser."""
    command = shared.parser(
        commands, "solve", "optimise a pose graph of your own, a g2o file", _DESCRIPTION, shared.DIALECTS_HELP
    )
    command.add_argument("graph", type=Path, metavar="GRAPH.g2o", help="a pose graph")
    command.add_argument("--dialect", choices=shared.DIALECTS, help="of a file that does not state it (default: g2o)")
    command.add_argument("--covariances", type=Path, nargs="+", metavar="TABLE", help="covariances by submap")
    command.add_argument(
        "--method", default=catalogue.NETWORK, help="method to take covariances of (default: %(default)s)"
    )
    command.add_argument(
        "--robust",
        choices=_KERNELS,
        default="none",
        help="estimator against wrong loop closures (default: %(default)s)",
    )
    command.add_argument(
        "--params", type=Path, default=Path("params.yaml"), help="parameters, for --robust (default: %(default)s)"
    )
    command.add_argument(
        "--out", type=Path, required=True, metavar="SOLVED.g2o", help="graph to write, in the same dialect"
    )
    command.add_argument(
        "--tum", type=Path, metavar="FILE", help="trajectory to write, with a vertex's number as its time"
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the solution and print the error of the edges before and after."""
    # these imports take seconds, and --help does not need them
    from pointnetkl.exchange import g2o, graph_exchange, graph_solver

    shared.require_apart(arguments.out, arguments.tum)
    content = g2o.read(arguments.graph, arguments.dialect)
    graph, dialect = content.graph, content.dialect
    counts = f"{len(graph.number)} vertices, {len(graph.edges.source)} edges"
    assumed = "" if content.is_stated else ", which the file does not say: --dialect names another"
    print(f"{arguments.graph}: {counts}, dialect {dialect}{assumed}")
    if arguments.covariances:
        graph = graph_exchange.with_covariances(graph, shared.covariances(arguments.covariances, arguments.method))
        count = int(graph_exchange.closes_loop(graph).sum())
        print(f"replaced: the covariance in the plane of {count} loop closures, by {arguments.method}")
    solved = graph_solver.solve(graph) if arguments.robust == "none" else _robust(graph, arguments)
    print(f"chi2: {solved.chi2_before:.6g} before, {solved.chi2_after:.6g} after")
    write(arguments.out, arguments.tum, graph, solved.poses, dialect)
    return 0


def _robust(graph: "Graph", arguments: argparse.Namespace) -> "Solution":
    """Return the solution by a robust estimator; print the loop closures that it did not accept."""
    from pointnetkl.exchange import graph_exchange, graph_solver
    from pointnetkl.slam.robust import estimators
    from pointnetkl.workflow import parameters

    thresholds = parameters.read(arguments.params, "stress.thresholds", estimators.Thresholds)
    doubted = np.flatnonzero(graph_exchange.closes_loop(graph))
    if not len(doubted):
        raise shared.CommandError(f"{arguments.graph}: has no loop closure to doubt; leave --robust out")
    solved, weights = graph_solver.solve_robust(graph, doubted, arguments.robust, thresholds)
    rejected = doubted[weights <= estimators.ACCEPTED]
    ends = (graph.number[nodes[rejected]] for nodes in (graph.edges.target, graph.edges.source))
    names = [f"{a}-{b}" for a, b in zip(*ends, strict=True)]
    print(f"{arguments.robust}: {len(names)} of {len(doubted)} loop closures not accepted: {' '.join(names) or 'none'}")
    return solved


def write(out: Path, trajectory: Path | None, graph: "Graph", poses: np.ndarray, dialect: str) -> None:
    """Write a graph with new poses, and if a path is given the poses as a trajectory in the order of vertex numbers."""
    import dataclasses

    from pointnetkl.exchange import g2o, tum

    g2o.write(out, dataclasses.replace(graph, poses=poses), dialect)
    if trajectory:
        order = np.argsort(graph.number)
        tum.write(
            trajectory, graph.number[order].astype(np.float64), poses[order], "a vertex's number stands for its time"
        )
