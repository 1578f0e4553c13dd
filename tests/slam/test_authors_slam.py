"""The authors' two slips: what acts in place of a covariance, and which loop closure is missing."""

import numpy as np
import pytest

from pointnetkl.slam.benchmark import authors_slips
from pointnetkl.slam.graph import pose_graph
from toy_survey import CLOSURE, graph

BLOCK = np.array([[3.35, -3.13], [-3.13, 5.45]])  # one of the authors' Antarctic loop closures, m^2
ACTS = np.array([[1.55, -1.67], [-1.67, 7.24]])  # and as it acts in their program


def whitened_wrongly(q: np.ndarray, residual: np.ndarray) -> float:
    """Return the squared length of a residual whitened by the Cholesky factor of the information, not transposed."""
    return float(np.sum((np.linalg.cholesky(np.linalg.inv(q)) @ residual) ** 2))


def covariance(m: int) -> np.ndarray:
    """Return a covariance with correlations."""
    A = np.random.default_rng(m).normal(size=(m, m))
    return A @ A.T + 0.1 * np.eye(m)


def test_the_authors_block_acts_as_it_does_in_their_program():
    assert authors_slips.acting(BLOCK) == pytest.approx(ACTS, abs=0.01)  # of numbers given to two decimals


@pytest.mark.parametrize("m", [2, 3, 6])
def test_what_acts_weighs_residuals_as_the_wrong_whitening_does(m: int):
    q = covariance(m)
    for residual in np.random.default_rng(0).normal(size=(5, m)):
        right = residual @ np.linalg.solve(authors_slips.acting(q), residual)
        assert right == pytest.approx(whitened_wrongly(q, residual))


def test_what_acts_is_as_large_as_what_was_given_but_lies_otherwise():
    q, acts = covariance(3), authors_slips.acting(covariance(3))
    assert np.trace(acts) == pytest.approx(np.trace(q))
    assert np.linalg.det(acts) == pytest.approx(np.linalg.det(q))
    assert not np.allclose(acts, q)


def test_on_an_edge_only_the_block_that_is_correlated_changes():
    full = pose_graph.closure_covariances(BLOCK[None], CLOSURE)
    acts = authors_slips.acting(full)
    assert acts[0, 3:5, 3:5] == pytest.approx(authors_slips.acting(BLOCK))
    same = np.ones((6, 6), bool)
    same[3:5, 3:5] = False
    assert acts[0][same] == pytest.approx(full[0][same])


def test_with_yaw_the_slip_takes_yaw_before_x_and_y():
    q = covariance(3) * 1e-2  # x, y, yaw
    acts = authors_slips.acting(pose_graph.closure_covariances(q[None], CLOSURE, np.zeros((1, 2))))[0]
    first_yaw = [2, 0, 1]
    assert acts[2:5, 2:5] == pytest.approx(authors_slips.acting(q[np.ix_(first_yaw, first_yaw)]))


def test_the_first_loop_closure_is_left_out_and_no_other():
    _, survey_graph = graph(3, 4)
    edges = survey_graph.closures.edges
    full = pose_graph.closure_covariances(np.tile(np.eye(2), (len(edges.source), 1, 1)), CLOSURE)
    kept, covariances = authors_slips.closures(edges, full)
    assert kept.source.tolist() == edges.source[1:].tolist()
    assert kept.target.tolist() == edges.target[1:].tolist()
    assert len(kept.T_target_source) == len(covariances) == len(edges.source) - 1
    none, nothing = authors_slips.closures(
        kept.__class__(edges.target[:0], edges.source[:0], edges.T_target_source[:0]), full[:0]
    )
    assert len(none.source) == len(nothing) == 0
