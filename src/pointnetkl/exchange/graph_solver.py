"""Any pose graph, solved by GTSAM: a user's own, which need not be dead reckoning and loop closures."""

import dataclasses
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pointnetkl.errors import PointNetKLError
from pointnetkl.exchange.g2o import Graph
from pointnetkl.exchange.graph_exchange import inverse
from pointnetkl.slam import robust
from pointnetkl.slam.pose_graph import Edges, Odometry
from pointnetkl.slam.robust import RobustGraph, Thresholds

_FIXED_SIGMA = 1e-6  # metres and radians: a given pose is held, and this says how
_ITERATIONS = 200  # a user's first poses may be far off
_TOLERANCE = 1e-8  # of the error; GTSAM's own, 1e-5, may leave poses centimetres from where they belong
_STEADY_M = 1e-3  # what a step more may move a pose at a minimum


class GraphSolverError(PointNetKLError):
    """A pose graph has no solution."""


@dataclass(frozen=True)
class Solution:
    """The most likely poses, and how far all edges are from them."""

    poses: np.ndarray  # (n, 4, 4) T_map_vertex
    chi2_before: float  # sum over edges of e^T information e, at the poses given
    chi2_after: float


class _Sure(Odometry):
    """What is beyond doubt in any graph, in place of dead reckoning."""

    def __init__(self, factors: gtsam.NonlinearFactorGraph, initial: gtsam.Values) -> None:
        self.factors, self.initial = factors, initial


def solve(graph: Graph) -> Solution:
    """Return the solution by Levenberg-Marquardt from the poses given; without a fixed node the first is held.

    Raises:
        GraphSolverError: a node is joined to none that is held, or the search does not end at a minimum.
    """
    graph = _held_first(graph)
    _require_joined(graph)
    factors = _edges(graph, np.arange(len(graph.edges.source)))
    _hold(factors, graph, graph.fixed)
    found = _poses(_minimum(factors, _values(graph.poses), len(graph.poses)), len(graph.poses))
    return _solution(graph, found)


def solve_robust(graph: Graph, doubted: np.ndarray, kernel: str, thresholds: Thresholds) -> tuple[Solution, np.ndarray]:
    """Return the solution by one of robust.KERNELS, and the weights, 0 to 1, of the edges (d,) that may be wrong.

    The search begins where robust.FIRST ends, which finds its way from poses that are far off.

    Raises:
        GraphSolverError: a node is joined to none that is held.
        RobustError: the linear system has no solution.
    """
    graph = _held_first(graph)
    _require_joined(graph)
    held = graph.fixed[0]
    order = np.concatenate([[held], np.delete(np.arange(len(graph.poses)), held)])  # RobustGraph holds its node 0
    key = np.argsort(order)
    ends = key[graph.edges.target], key[graph.edges.source]
    keyed = dataclasses.replace(
        graph, poses=graph.poses[order], edges=dataclasses.replace(graph.edges, target=ends[0], source=ends[1])
    )
    sure = _edges(keyed, np.setdiff1d(np.arange(len(ends[0])), doubted))
    _hold(sure, keyed, key[graph.fixed[1:]])
    closures = Edges(ends[0][doubted], ends[1][doubted], graph.edges.measured[doubted])
    covariances = inverse(graph.information[doubted])
    odometry = _Sure(sure, _values(keyed.poses))
    made = RobustGraph(keyed.poses[0], closures, covariances, odometry, thresholds)
    found = made.solve(robust.FIRST)
    if kernel != robust.FIRST:
        found = made.solve(kernel, found)
    return _solution(graph, found.poses[key]), found.weights


def _held_first(graph: Graph) -> Graph:
    return graph if len(graph.fixed) else dataclasses.replace(graph, fixed=np.zeros(1, np.int64))


def _values(poses: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    for node, T in enumerate(poses):
        values.insert(node, gtsam.Pose3(T))
    return values


def _hold(factors: gtsam.NonlinearFactorGraph, graph: Graph, nodes: np.ndarray) -> None:
    model = gtsam.noiseModel.Isotropic.Sigma(6, _FIXED_SIGMA)
    for node in nodes.tolist():
        factors.add(gtsam.PriorFactorPose3(node, gtsam.Pose3(graph.poses[node]), model))


def _solution(graph: Graph, poses: np.ndarray) -> Solution:
    edges = _edges(graph, np.arange(len(graph.edges.source)))
    return Solution(poses, 2 * edges.error(_values(graph.poses)), 2 * edges.error(_values(poses)))


def _minimum(factors: gtsam.NonlinearFactorGraph, initial: gtsam.Values, count: int) -> gtsam.Values:
    """Return where the search ends, if one step more, undamped, does not move a pose."""
    search, step = gtsam.LevenbergMarquardtParams(), gtsam.GaussNewtonParams()
    search.setMaxIterations(_ITERATIONS)
    search.setRelativeErrorTol(_TOLERANCE)
    search.setAbsoluteErrorTol(_TOLERANCE)
    for how in (search, step):
        how.setLinearSolverType("MULTIFRONTAL_QR")  # Cholesky's squared numbers fail beside a sigma of millimetres
    try:
        found = gtsam.LevenbergMarquardtOptimizer(factors, initial, search).optimize()
        further = gtsam.GaussNewtonOptimizer(factors, found, step)
        further.iterate()
    except RuntimeError as error:  # a system that is singular to working precision
        raise _no_minimum(count) from error
    moved = np.abs(_poses(further.values(), count) - _poses(found, count))[:, :3, 3].max()
    if not moved < _STEADY_M:  # NaN is not
        raise _no_minimum(count)
    return further.values()


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


def _poses(values: gtsam.Values, count: int) -> np.ndarray:
    return np.array([values.atPose3(node).matrix() for node in range(count)])


def _no_minimum(count: int) -> GraphSolverError:
    return GraphSolverError(
        f"a graph of {count} vertices has no solution: the search ends at no minimum; look for first poses that are far"
        " off, and for an information that is next to singular"
    )
