"""Converts the pipeline's graphs to those of g2o files, and puts our covariances on the edges of other graphs."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from pointnetkl.exchange import g2o
from pointnetkl.slam.graph import pose_graph
from pointnetkl.slam.graph.pose_graph import DeadReckoningNoise, Edges
from pointnetkl.surveys.se2 import SE2
from pointnetkl.workflow.errors import PointNetKLError


class GraphExchangeError(PointNetKLError):
    """A submap that closes a loop has no covariance."""


def join(
    number: np.ndarray,
    poses: np.ndarray,
    dead_reckoning: np.ndarray,
    noise: DeadReckoningNoise,
    closures: Edges,
    covariances: np.ndarray,
) -> g2o.Graph:
    """Return the graph of submaps (n,) at poses (n, 4, 4) with its first node held.

    Its edges are dead reckoning (n - 1, 4, 4) with its noise, and closures with covariances (e, 6, 6) in their
    sources' frames, rotation first.
    """
    node = np.arange(len(number))
    odometry = np.tile(np.diag(pose_graph.sigmas(noise) ** -2.0), (len(node) - 1, 1, 1))
    edges = Edges(
        np.concatenate([node[:-1], closures.target]),
        np.concatenate([node[1:], closures.source]),
        np.concatenate([dead_reckoning, closures.T_target_source]),
    )
    return g2o.Graph(number, poses, edges, np.concatenate([odometry, inverse(covariances)]), node[:1])


def closes_loop(graph: g2o.Graph) -> np.ndarray:
    """Return which (e,) edges join vertices whose numbers are not neighbours."""
    return np.abs(graph.number[graph.edges.source] - graph.number[graph.edges.target]) > 1


def with_covariances(graph: g2o.Graph, q: Mapping[int, np.ndarray]) -> g2o.Graph:
    """Return the graph with Q (M, M) by submap for x and y (and yaw, M = 3) of its loop closures.

    Of the two submaps of a loop closure the later one, with the higher number, counts as the registered one, and Q is
    in its frame. Where it is the edge's first vertex, Q is moved to the frame of the second. The edge keeps its
    variances of the other axes; correlations between them and x, y (and yaw) become zero.

    Raises:
        GraphExchangeError: a submap that closes a loop has no Q.
    """
    closing = np.flatnonzero(closes_loop(graph))
    covariances = inverse(graph.information[closing])
    for covariance, edge in zip(covariances, closing.tolist(), strict=True):
        in_source = _in_source_frame(graph, edge, q)
        axes = pose_graph.XY_YAW[: len(in_source)]
        covariance[axes] = covariance[:, axes] = 0.0
        covariance[axes[:, None], axes] = in_source
    information = graph.information.copy()
    information[closing] = inverse(covariances)
    return dataclasses.replace(graph, information=information)


def inverse(matrices: np.ndarray) -> np.ndarray:
    """Return the inverses of positive definite matrices (e, k, k), accurate in any units of their axes."""
    scale = 1 / np.sqrt(np.diagonal(matrices, axis1=1, axis2=2))
    scaled = scale[:, :, None] * matrices * scale[:, None]
    inverted = scale[:, :, None] * np.linalg.inv(scaled) * scale[:, None]
    return np.asarray((inverted + np.swapaxes(inverted, 1, 2)) / 2)


def _in_source_frame(graph: g2o.Graph, edge: int, q: Mapping[int, np.ndarray]) -> np.ndarray:
    """Return Q (M, M) of an edge's later submap in the frame of its second vertex, where GTSAM has the error."""
    first, second = (int(graph.number[ends[edge]]) for ends in (graph.edges.target, graph.edges.source))
    later = max(first, second)
    if later not in q:
        raise GraphExchangeError(f"submap {later} closes a loop with {min(first, second)} and has no covariance")
    if later == second:
        return q[later]
    T_second_first = SE2.from_matrix(np.linalg.inv(graph.edges.T_target_source[edge]))
    adjoint = T_second_first.adjoint()[: len(q[later]), : len(q[later])]
    return np.asarray(adjoint @ q[later] @ adjoint.T)
