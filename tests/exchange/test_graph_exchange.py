"""Our covariances on the edges of other graphs: on which, in whose frame, and what of the edge remains."""

import dataclasses

import numpy as np
import pytest

import graphs
from pointnetkl.exchange import g2o, graph_exchange, graph_solver
from pointnetkl.exchange.graph_exchange import GraphExchangeError
from pointnetkl.slam.graph.pose_graph import Edges
from toy_graphs import CROSSING, LONG_X, closure, crossing


def reversed_edge(edges: Edges) -> Edges:
    return Edges(edges.source, edges.target, np.linalg.inv(edges.T_target_source))


def moved(graph: g2o.Graph) -> np.ndarray:
    """Return how far solving the graph moves its last vertex, in the map."""
    return (graph_solver.solve(graph).poses - CROSSING)[3, :2, 3]


def test_q_of_the_later_submap_gives_one_solution_whichever_way_its_edge_runs():
    forward = closure(1, 3, CROSSING, (4.0, 4.0))
    q = {3: LONG_X}
    forth, back = (graph_exchange.with_covariances(crossing(e), q) for e in (forward, reversed_edge(forward)))
    assert moved(forth)[0] > 2.0  # next to nothing is known along the source's x, the map's y
    assert abs(moved(forth)[1]) < 0.1
    assert moved(back) == pytest.approx(moved(forth), abs=0.05)
    assert moved(forth) == pytest.approx(moved(crossing(forward, LONG_X)), abs=1e-9)
    unturned = crossing(reversed_edge(forward), LONG_X)
    assert abs(moved(unturned)[0]) < 0.1 < moved(unturned)[1]


def test_a_q_with_yaw_describes_the_same_error_whichever_way_its_edge_runs():
    q = np.diag([0.04, 0.09, 1e-4]) + 1e-3 * (np.eye(3, k=2) + np.eye(3, k=-2))
    forward = closure(0, 3, CROSSING, (4.0, 4.0))
    back = graph_exchange.with_covariances(crossing(reversed_edge(forward)), {3: q})
    covariance = graph_exchange.inverse(back.information)[-1][np.ix_([3, 4, 2], [3, 4, 2])]
    x, y, yaw = 1e-2 * np.random.default_rng(0).multivariate_normal(np.zeros(3), q, 40_000).T
    e = np.tile(np.eye(4), (len(x), 1, 1))
    e[:, 0, 0], e[:, 0, 1], e[:, 1, 0], e[:, 1, 1] = np.cos(yaw), -np.sin(yaw), np.sin(yaw), np.cos(yaw)
    e[:, 0, 3], e[:, 1, 3] = x, y
    T = forward.T_target_source[0]
    residual = T @ np.linalg.inv(T @ e)  # of the reversed edge, in the frame of the earlier submap
    errors = np.stack([residual[:, 0, 3], residual[:, 1, 3], np.arctan2(residual[:, 1, 0], residual[:, 0, 0])])
    size = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        covariance / np.outer(size, size), 1e4 * np.cov(errors) / np.outer(size, size), atol=0.03
    )
    assert size[1] > 4 * 0.2  # the yaw's lever is 100 m


def test_only_loop_closures_change_and_keep_their_height_roll_pitch_and_yaw():
    graph = crossing(closure(1, 3, CROSSING, (4.0, 4.0)))
    graph = dataclasses.replace(graph, information=graphs.definite(4, np.random.default_rng(0), 1.0))
    changed = graph_exchange.with_covariances(graph, {3: LONG_X})
    np.testing.assert_array_equal(changed.information[:3], graph.information[:3])
    before, after = (graph_exchange.inverse(g.information)[3] for g in (graph, changed))
    rest = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
    np.testing.assert_allclose(after[rest], before[rest], rtol=1e-9)
    np.testing.assert_allclose(after[3:5, 3:5], LONG_X, rtol=1e-9)
    np.testing.assert_allclose(after[[0, 1, 2, 5], 3:5], 0, atol=1e-9)


def test_a_loop_closure_joins_numbers_that_are_no_neighbours_wherever_they_stand_in_the_file():
    edges = closure(0, 3, CROSSING, (0.0, 0.0))
    assert graph_exchange.closes_loop(crossing(edges)).tolist() == [False, False, False, True]
    shuffled = crossing(edges, numbers=(2, 0, 4, 3))
    assert graph_exchange.closes_loop(shuffled).tolist() == [True, True, False, False]


def test_a_loop_closure_without_a_q_is_named():
    with pytest.raises(GraphExchangeError, match="submap 3 closes a loop with 1 and has no covariance"):
        graph_exchange.with_covariances(crossing(closure(1, 3, CROSSING, (4.0, 4.0))), {1: LONG_X})


def test_an_inverse_is_one_whatever_the_units():
    matrices = graphs.definite(30, np.random.default_rng(0))
    scale = np.sqrt(np.diagonal(matrices, axis1=1, axis2=2))
    product = graph_exchange.inverse(matrices) @ matrices
    np.testing.assert_allclose(scale[:, :, None] * product / scale[:, None], np.tile(np.eye(6), (30, 1, 1)), atol=1e-9)
