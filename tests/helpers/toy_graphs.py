"""Small pose graphs: two lines that cross, and a mesh of many loop closures."""

import dataclasses

import numpy as np

from pointnetkl.exchange import g2o, graph_exchange
from pointnetkl.slam.graph import pose_graph
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.surveys import pose
from toy_survey import CLOSURE, DEAD_RECKONING

# A first line runs east, and a second one crosses it northwards, so that its submap's x is the map's y.
CROSSING = np.array(
    [
        pose.matrix(np.array([0.0, 0.0, -20.0]), 0.0),
        pose.matrix(np.array([100.0, 0.0, -20.0]), 0.0),
        pose.matrix(np.array([200.0, -100.0, -20.0]), 0.0),
        pose.matrix(np.array([100.0, 0.0, -20.0]), np.pi / 2),
    ]
)
LONG_X = np.diag([1e4, 1e-2])  # x is hardly known
NO_EDGES = Edges(np.empty(0, int), np.empty(0, int), np.empty((0, 4, 4)))
Q_IN_FILE = np.diag([0.5, 0.5])


def closure(target: int, source: int, poses: np.ndarray, shift: tuple[float, float]) -> Edges:
    """Return the edge of a registration with an error of `shift` in the map frame."""
    shifted = poses[source].copy()
    shifted[:2, 3] += shift
    measured = np.linalg.inv(poses[target]) @ shifted
    return Edges(np.array([target]), np.array([source]), measured[None])


def crossing(closures: Edges, q: np.ndarray = Q_IN_FILE, numbers: tuple[int, ...] = (0, 1, 2, 3)) -> g2o.Graph:
    """Return the graph of the crossing lines with some closures."""
    full = pose_graph.closure_covariances(np.tile(q, (len(closures.source), 1, 1)), CLOSURE)
    relative = pose_graph.between(CROSSING)
    return graph_exchange.join(np.array(numbers), CROSSING, relative, DEAD_RECKONING, closures, full)


def mesh() -> tuple[g2o.Graph, int]:
    """Return a graph of many loop closures, and the edge of the one that is wrong; its first vertex is not held."""
    truth = np.array([pose.matrix(np.array([30.0 * (k % 4), 20.0 * (k // 4), 0.0]), 0.5 * k) for k in range(14)])
    pairs = np.array([(k, k + step) for step in (2, 4) for k in range(14 - step)])
    rng = np.random.default_rng(0)
    noise = np.tile(np.eye(4), (len(pairs), 1, 1))
    noise[:, :2, 3] = 0.2 * rng.normal(size=(len(pairs), 2))
    measured = np.linalg.inv(truth[pairs[:, 0]]) @ truth[pairs[:, 1]] @ noise
    measured[9, :2, 3] += 30.0
    full = pose_graph.closure_covariances(np.tile(0.04 * np.eye(2), (len(pairs), 1, 1)), CLOSURE)
    relative = pose_graph.between(truth) @ [pose.matrix(np.zeros(3), yaw) for yaw in rng.normal(0, 0.01, 13)]
    closures = Edges(pairs[:, 0], pairs[:, 1], measured)
    start = pose_graph.chain(truth[0], relative)
    graph = graph_exchange.join(np.arange(14), start, relative, DEAD_RECKONING, closures, full)
    order = np.array([5, 1, 2, 3, 4, 0, *range(6, 14)])  # its own inverse
    edges = Edges(order[graph.edges.target], order[graph.edges.source], graph.edges.T_target_source)
    shuffled = dataclasses.replace(graph, number=order, poses=start[order], edges=edges, fixed=order[graph.fixed])
    return shuffled, 13 + 9
