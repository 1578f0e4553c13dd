"""Solving any graph: what is held, what is minimised, and which loop closures a robust solver believes."""

import dataclasses
from pathlib import Path

import gtsam
import numpy as np
import pytest

import graphs
from pointnetkl.exchange import g2o, graph_exchange, graph_solver
from pointnetkl.exchange.graph_solver import GraphSolverError
from pointnetkl.slam.graph import gtsam_search
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.robust import estimators
from pointnetkl.slam.robust import schemas as robust_schemas
from pointnetkl.surveys import pose
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError
from toy_graphs import CROSSING, NO_EDGES, closure, crossing, mesh

PARAMS = Path(__file__).parents[2] / "params.yaml"


def without(graph: g2o.Graph, edge: int) -> g2o.Graph:
    kept = Edges(*(np.delete(part, edge, 0) for part in dataclasses.astuple(graph.edges)))
    return dataclasses.replace(graph, edges=kept, information=np.delete(graph.information, edge, 0))


@pytest.mark.parametrize("kernel", robust_schemas.KERNELS[1:])
def test_a_robust_solution_is_nearly_that_without_the_wrong_closure(kernel: str):
    graph, wrong = mesh()
    doubted = np.flatnonzero(graph_exchange.closes_loop(graph))
    thresholds = parameters.read(PARAMS, "stress.thresholds", estimators.Thresholds)
    robust, weights = graph_solver.solve_robust(graph, doubted, kernel, thresholds)
    right, plain = graph_solver.solve(without(graph, wrong)), graph_solver.solve(graph)
    assert doubted[weights.argmin()] == wrong
    assert weights.min() < 0.1 < 0.5 < np.median(weights)
    error, plain_error = (np.abs(solution.poses - right.poses)[:, :2, 3].max() for solution in (robust, plain))
    assert error < 0.3 < 1.0 < plain_error
    np.testing.assert_allclose(robust.poses[graph.fixed], graph.poses[graph.fixed], atol=1e-6)
    assert plain.chi2_after < robust.chi2_after < robust.chi2_before


def test_a_robust_kernel_that_doubts_nothing_gives_the_plain_solution():
    graph, wrong = mesh()
    sound = without(graph, wrong)
    doubted = np.flatnonzero(graph_exchange.closes_loop(sound))
    easy = estimators.Thresholds(1e3, 1e3, 1e6, 0.999999, 2.0)
    robust, weights = graph_solver.solve_robust(sound, doubted, "huber", easy)
    assert weights.min() == 1
    np.testing.assert_allclose(robust.poses, graph_solver.solve(sound).poses, atol=1e-3)


def test_a_graph_of_damaged_numbers_is_solved_or_ends_in_an_error_of_ours(tmp_path: Path):
    whole, rng, solved = g2o.to_text(mesh()[0], "g2o").encode(), np.random.default_rng(0), 0
    for _ in range(150):
        words = graphs.mutated(whole, rng).split(b" ")
        words[int(rng.integers(len(words)))] = rng.choice([b"1e300", b"-1e308", b"1e-300", b"0", b"1e160"])
        (tmp_path / "a.g2o").write_bytes(b" ".join(words))
        try:
            solution = graph_solver.solve(g2o.read(tmp_path / "a.g2o").graph)
        except PointNetKLError:
            continue
        solved += 1
        assert np.isfinite(solution.poses).all()
    assert 5 < solved < 145


def test_the_solver_s_chi2_is_the_sum_over_edges():
    graph = crossing(closure(1, 3, CROSSING, (4.0, -3.0)))
    solved = graph_solver.solve(graph)
    assert solved.chi2_before == pytest.approx((4**2 + 3**2) / 0.5)
    poses, edges = solved.poses, graph.edges
    residual = np.linalg.inv(edges.T_target_source) @ np.linalg.inv(poses[edges.target]) @ poses[edges.source]
    e = np.array([gtsam.Pose3.Logmap(gtsam.Pose3(T)) for T in residual])
    assert solved.chi2_after == pytest.approx(np.einsum("ei,eij,ej->", e, graph.information, e), rel=1e-4)
    assert solved.chi2_after < solved.chi2_before


def test_what_is_fixed_stays_and_without_it_the_first_vertex_does():
    graph = crossing(closure(1, 3, CROSSING, (4.0, 4.0)))
    both = graph_solver.solve(dataclasses.replace(graph, fixed=np.array([0, 3]))).poses
    np.testing.assert_allclose(both[[0, 3]], CROSSING[[0, 3]], atol=1e-6)
    none = graph_solver.solve(dataclasses.replace(graph, fixed=np.empty(0, int))).poses
    np.testing.assert_allclose(none, graph_solver.solve(graph).poses)


def test_a_vertex_that_nothing_holds_is_named():
    graph = crossing(NO_EDGES)
    apart = Edges(*(part[:2] for part in (graph.edges.target, graph.edges.source, graph.edges.T_target_source)))
    loose = dataclasses.replace(graph, edges=apart, information=graph.information[:2])
    with pytest.raises(GraphSolverError, match="vertex 3 is joined by no edges to a vertex that is held"):
        graph_solver.solve(loose)
    assert len(graph_solver.solve(dataclasses.replace(loose, fixed=np.array([0, 3]))).poses) == 4


def test_poses_that_still_move_at_an_error_that_does_not_change_are_a_solution(monkeypatch: pytest.MonkeyPatch):
    graph, _ = mesh()
    solution = graph_solver.solve(graph)
    monkeypatch.setattr(gtsam_search, "_STEADY_M", 0.0)  # as on a bend that no edge feels: no step is small enough
    again = graph_solver.solve(graph)
    np.testing.assert_allclose(again.poses, solution.poses, atol=1e-3)
    assert again.chi2_after == pytest.approx(solution.chi2_after, rel=1e-8)


def test_a_search_that_does_not_come_to_rest_says_how_far_it_still_moves(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gtsam_search, "optimise", lambda *_: gtsam_search.End(np.empty((14, 4, 4)), 0.3, 1e-3))
    with pytest.raises(GraphSolverError, match=r"14 vertices is not settled: the last step moved a pose by 0\.3 m"):
        graph_solver.solve(mesh()[0])


def test_a_sigma_of_a_tenth_of_a_millimetre_does_not_stop_the_solver():
    sharp = np.diag([1e-8, 1e-8])
    moved = graph_solver.solve(crossing(closure(1, 3, CROSSING, (4.0, 4.0)), sharp)).poses - CROSSING
    assert moved[3, :2, 3] == pytest.approx([4.0, 4.0], abs=1e-3)
    assert pose.yaw_of(graph_solver.solve(crossing(NO_EDGES)).poses[3]) == pytest.approx(np.pi / 2)
