"""Command `solve`: a pose graph of one's own, optimised, with our covariances on its loop closures if wanted."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.commands import shared

_KERNELS = ("none", "huber", "cauchy", "dcs", "gnc")  # robust.KERNELS, without the second that its import takes
_DESCRIPTION = """\
The most likely poses of a pose graph in a g2o file (3D: VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX), by GTSAM's
Levenberg-Marquardt from the poses in the file. What is FIXed is held; without such a line, the first vertex.

With --covariances, x and y (and yaw, where the table has it) of every loop closure, an edge between vertices i and j
with |i - j| > 1, get the covariance Q of the later submap: a vertex is named by its submap's number, and the later of
the two is taken for the registered one. Q is in that submap's levelled frame; where the submap is the edge's first
vertex Q is turned to the frame of the second, in which g2o and GTSAM have an edge's error. The edge's z, roll, pitch
(and yaw) keep their variances; correlations between them and x, y are dropped. Q enters as the table has it: without
the floor (slam.floor_m2 of the parameters) that `export` adds, and with its full weight on every edge of a submap, as
`export --edges all` has it.

--robust weighs down loop closures that contradict the rest, and names those whose weight is a half or less; other edges
are believed. What counts is the length of a closure's residual at the solution, whitened by its covariance: with the
thresholds as they come (stress.thresholds of the parameters) a weight is a half at 1.0 (cauchy), 1.35 (dcs) and 2.69
(huber), and gnc lets go at 4.1.
"""


def add(commands: Any) -> None:
    """Add the command's words."""
    command = shared.parser(commands, "solve", "a g2o file of your own, optimised", _DESCRIPTION, shared.DIALECTS)
    command.add_argument("graph", type=Path, metavar="GRAPH.g2o", help="a pose graph")
    command.add_argument("--dialect", choices=("g2o", "gtsam"), help="of a file that does not say it (default: g2o)")
    command.add_argument("--covariances", type=Path, nargs="+", metavar="TABLE", help="covariances by submap")
    command.add_argument("--method", default="network", help="whose covariances (default: %(default)s)")
    command.add_argument(
        "--robust", choices=_KERNELS, default="none", help="against wrong loop closures (default: %(default)s)"
    )
    command.add_argument("--params", type=Path, default=Path("params.yaml"), help="for --robust (default: %(default)s)")
    command.add_argument("--out", type=Path, required=True, metavar="SOLVED.g2o", help="graph to write, same dialect")
    command.add_argument("--tum", type=Path, metavar="FILE", help="trajectory to write; a vertex's number is its time")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the solution and print how far the edges are from it."""
    # some seconds, which --help need not take
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


def _robust(graph: Any, arguments: argparse.Namespace) -> Any:
    """Return the solution by a robust estimator; print the loop closures that it did not believe."""
    from pointnetkl.exchange import graph_exchange, graph_solver
    from pointnetkl.slam.robust import estimators
    from pointnetkl.workflow import parameters

    thresholds = parameters.read(arguments.params, "stress.thresholds", estimators.Thresholds)
    doubted = np.flatnonzero(graph_exchange.closes_loop(graph))
    if not len(doubted):
        raise shared.CommandError(f"{arguments.graph}: has no loop closure to doubt; leave --robust out")
    solved, weights = graph_solver.solve_robust(graph, doubted, arguments.robust, thresholds)
    out = doubted[weights <= estimators.ACCEPTED]
    ends = (graph.number[nodes[out]] for nodes in (graph.edges.target, graph.edges.source))
    wrong = [f"{a}-{b}" for a, b in zip(*ends, strict=True)]
    print(f"{arguments.robust}: {len(wrong)} of {len(doubted)} loop closures not believed: {' '.join(wrong) or 'none'}")
    return solved


def write(out: Path, trajectory: Path | None, graph: Any, poses: np.ndarray, dialect: str) -> None:
    """Write a graph with other poses, and if wanted these as a trajectory, in the order of the vertices' numbers."""
    import dataclasses

    from pointnetkl.exchange import g2o, tum

    g2o.write(out, dataclasses.replace(graph, poses=poses), dialect)
    if trajectory:
        order = np.argsort(graph.number)
        tum.write(
            trajectory, graph.number[order].astype(np.float64), poses[order], "a vertex's number stands for its time"
        )
