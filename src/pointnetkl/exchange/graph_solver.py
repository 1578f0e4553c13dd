"""Solves any pose graph by GTSAM, also one that is not dead reckoning and loop closures."""

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
from pointnetkl.slam.robust import schemas as robust_schemas
from pointnetkl.slam.robust.estimators import RobustGraph, Thresholds
from pointnetkl.workflow.errors import PointNetKLError

_ITERATIONS = 200  # a user's first poses may be far off
_FLAT, _FAR_M = 1e-8, 1.0  # steps along a long bend that no edge resists move poses and do not change the error


class GraphSolverError(PointNetKLError):
    """A pose graph has no solution."""


@dataclass(frozen=True)
class Solution:
    """The most likely poses, and the error of all edges there."""

    poses: np.ndarray  # (n, 4, 4) T_map_vertex
    chi2_before: float  # sum over edges of e^T information e, at the graph's poses
    chi2_after: float


def solve(graph: Graph) -> Solution:
    """Return the solution by Levenberg-Marquardt from the graph's poses; without a fixed node the first is held.

    Raises:
        GraphSolverError: a node is not connected to a held one, or the search does not end at a minimum.
    """
    graph = _held_first(graph)
    _require_connected(graph)
    search = gtsam_search.precise_search(_ITERATIONS)
    search.setLinearSolverType("MULTIFRONTAL_QR")  # Cholesky's squared numbers fail beside a sigma of millimetres
    factors = _factors(graph, np.arange(len(graph.edges.source)))
    end = gtsam_search.optimise(factors, gtsam_search.to_values(graph.poses), search)
    advice = "look for first poses that are far off, and for an information that is next to singular"
    if end is None or not np.isfinite(end.moved_m):
        raise GraphSolverError(f"a graph of {len(graph.poses)} vertices has no solution: it is singular; {advice}")
    if not end.is_steady and not (end.change < _FLAT and end.moved_m < _FAR_M):
        raise GraphSolverError(
            f"a graph of {len(graph.poses)} vertices is not settled: the last step moved a pose by"
            f" {end.moved_m:.3g} m; {advice}"
        )
    return _solution(graph, end.poses)


def solve_robust(graph: Graph, doubted: np.ndarray, kernel: str, thresholds: Thresholds) -> tuple[Solution, np.ndarray]:
    """Return the solution by one of robust.schemas.KERNELS, and the weights, 0 to 1, of the doubted edges (d,).

    The search starts from the solution of kernel FIRST, which succeeds from poses that are far off.

    Raises:
        GraphSolverError: a node is not connected to a held one.
        RobustError: the linear system has no solution.
    """
    graph = _held_first(graph)
    _require_connected(graph)
    closures = Edges(*(part[doubted] for part in (graph.edges.target, graph.edges.source, graph.edges.T_target_source)))
    trusted = _factors(graph, np.setdiff1d(np.arange(len(graph.edges.source)), doubted))
    covariances = inverse(graph.information[doubted])
    robust_graph = RobustGraph(trusted, gtsam_search.to_values(graph.poses), closures, covariances, thresholds)
    solution = robust_graph.solve(robust_schemas.FIRST)
    if kernel != robust_schemas.FIRST:
        solution = robust_graph.solve(kernel, solution)
    return _solution(graph, solution.poses), solution.weights


def _held_first(graph: Graph) -> Graph:
    return graph if len(graph.fixed) else dataclasses.replace(graph, fixed=np.zeros(1, np.int64))


def _factors(graph: Graph, indices: np.ndarray) -> gtsam.NonlinearFactorGraph:
    """Return the factors of some edges (k,), and those that hold the fixed nodes."""
    fixed = {node: graph.poses[node] for node in graph.fixed.tolist()}
    return gtsam_search.join(_edges(graph, indices), gtsam_search.hold(fixed))


def _solution(graph: Graph, poses: np.ndarray) -> Solution:
    edges = _edges(graph, np.arange(len(graph.edges.source)))
    before, after = (2 * edges.error(gtsam_search.to_values(T)) for T in (graph.poses, poses))
    return Solution(poses, before, after)


def _edges(graph: Graph, indices: np.ndarray) -> gtsam.NonlinearFactorGraph:
    factors = gtsam.NonlinearFactorGraph()
    edges = graph.edges
    for e in indices.tolist():
        model = gtsam.noiseModel.Gaussian.Information(graph.information[e])
        ends = int(edges.target[e]), int(edges.source[e])
        factors.add(gtsam.BetweenFactorPose3(*ends, gtsam.Pose3(edges.T_target_source[e]), model))
    return factors


def _require_connected(graph: Graph) -> None:
    # Levenberg-Marquardt would leave such nodes where they are, without an error
    n, ends = len(graph.poses), (graph.edges.target, graph.edges.source)
    _, component = connected_components(coo_array((np.ones(len(ends[0])), ends), (n, n)), directed=False)
    loose = ~np.isin(component, component[graph.fixed])
    if loose.any():
        raise GraphSolverError(
            f"vertex {graph.number[loose.argmax()]} is joined by no edges to a vertex that is held;"
            " add a line FIX for one vertex of each part"
        )
