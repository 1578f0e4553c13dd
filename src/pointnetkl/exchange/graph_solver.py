"""Any pose graph, solved by GTSAM: a user's own, which need not be dead reckoning and loop closures."""

import dataclasses
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pointnetkl.exchange.g2o import Graph
from pointnetkl.exchange.graph_exchange import inverse
from pointnetkl.slam.graph import gtsam_search
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.robust import tables as robust_tables
from pointnetkl.slam.robust.estimators import RobustGraph, Thresholds
from pointnetkl.workflow.errors import PointNetKLError

_ITERATIONS = 200  # a user's first poses may be far off
_FLAT, _FAR_M = 1e-8, 1.0  # of a bend so long that no edge feels it, steps move poses and leave the error as it is


class GraphSolverError(PointNetKLError):
    """A pose graph has no solution."""


@dataclass(frozen=True)
class Solution:
    """The most likely poses, and how far all edges are from them."""

    poses: np.ndarray  # (n, 4, 4) T_map_vertex
    chi2_before: float  # sum over edges of e^T information e, at the poses given
    chi2_after: float


def solve(graph: Graph) -> Solution:
    """Return the solution by Levenberg-Marquardt from the poses given; without a fixed node the first is held.

    Raises:
        GraphSolverError: a node is joined to none that is held, or the search does not end at a minimum.
    """
    graph = _held_first(graph)
    _require_joined(graph)
    search = gtsam_search.precisely(_ITERATIONS)
    search.setLinearSolverType("MULTIFRONTAL_QR")  # Cholesky's squared numbers fail beside a sigma of millimetres
    factors = _factors(graph, np.arange(len(graph.edges.source)))
    found = gtsam_search.rest(factors, gtsam_search.to_values(graph.poses), search)
    look = "look for first poses that are far off, and for an information that is next to singular"
    if found is None or not np.isfinite(found.moved_m):
        raise GraphSolverError(f"a graph of {len(graph.poses)} vertices has no solution: it is singular; {look}")
    if not found.is_steady and not (found.change < _FLAT and found.moved_m < _FAR_M):
        raise GraphSolverError(
            f"a graph of {len(graph.poses)} vertices is not settled: the last step moved a pose by"
            f" {found.moved_m:.3g} m; {look}"
        )
    return _solution(graph, found.poses)


def solve_robust(graph: Graph, doubted: np.ndarray, kernel: str, thresholds: Thresholds) -> tuple[Solution, np.ndarray]:
    """Return the solution by one of robust.KERNELS, and the weights, 0 to 1, of the edges (d,) that may be wrong.

    The search begins where robust.FIRST ends, which finds its way from poses that are far off.

    Raises:
        GraphSolverError: a node is joined to none that is held.
        RobustError: the linear system has no solution.
    """
    graph = _held_first(graph)
    _require_joined(graph)
    closures = Edges(*(part[doubted] for part in (graph.edges.target, graph.edges.source, graph.edges.measured)))
    sure = _factors(graph, np.setdiff1d(np.arange(len(graph.edges.source)), doubted))
    covariances = inverse(graph.information[doubted])
    made = RobustGraph(sure, gtsam_search.to_values(graph.poses), closures, covariances, thresholds)
    found = made.solve(robust_tables.FIRST)
    if kernel != robust_tables.FIRST:
        found = made.solve(kernel, found)
    return _solution(graph, found.poses), found.weights


def _held_first(graph: Graph) -> Graph:
    return graph if len(graph.fixed) else dataclasses.replace(graph, fixed=np.zeros(1, np.int64))


def _factors(graph: Graph, which: np.ndarray) -> gtsam.NonlinearFactorGraph:
    """Return some edges, and what holds the fixed nodes."""
    fixed = {node: graph.poses[node] for node in graph.fixed.tolist()}
    return gtsam_search.joined(_edges(graph, which), gtsam_search.held(fixed))


def _solution(graph: Graph, poses: np.ndarray) -> Solution:
    edges = _edges(graph, np.arange(len(graph.edges.source)))
    before, after = (2 * edges.error(gtsam_search.to_values(each)) for each in (graph.poses, poses))
    return Solution(poses, before, after)


def _edges(graph: Graph, which: np.ndarray) -> gtsam.NonlinearFactorGraph:
    factors = gtsam.NonlinearFactorGraph()
    edges = graph.edges
    for e in which.tolist():
        model = gtsam.noiseModel.Gaussian.Information(graph.information[e])
        ends = int(edges.target[e]), int(edges.source[e])
        factors.add(gtsam.BetweenFactorPose3(*ends, gtsam.Pose3(edges.measured[e]), model))
    return factors


def _require_joined(graph: Graph) -> None:
    # Levenberg and Marquardt would leave such nodes where they are, without a word
    n, ends = len(graph.poses), (graph.edges.target, graph.edges.source)
    _, part = connected_components(coo_array((np.ones(len(ends[0])), ends), (n, n)), directed=False)
    loose = ~np.isin(part, part[graph.fixed])
    if loose.any():
        raise GraphSolverError(
            f"vertex {graph.number[loose.argmax()]} is joined by no edges to a vertex that is held;"
            " add a line FIX for one vertex of each part"
        )
