"""Poses from navigation and closures in covariance form: against GTSAM, and the axioms of ties and gates."""

import dataclasses

import gtsam
import numpy as np
import pytest

import closable
from pointnetkl.registration.pair import factor
from pointnetkl.slam.closing import gates, gtsam_factor, solving
from pointnetkl.slam.closing.estimate import (
    ClosingError,
    Closure,
    Estimate,
    Tie,
    from_matrices,
    linearised,
    to_matrices,
)
from pointnetkl.slam.graph import gtsam_search, pose_graph
from pointnetkl.surveys.se2 import SE2

TOY = closable.sail("flat", lines=2)
POSES = from_matrices(closable.moved(TOY.truth, np.tile([0.0, 0.0, 0.4], (len(TOY.truth), 1))))
EDGE = np.array([0.3, 0.2, 2e-3])  # x, y, yaw of one edge, in its own frame
LEVER = np.array([12.0, -7.0])
RIDGE, BOTH = np.array([[0.0, 4.0]]), np.array([[2.0, 0.5], [0.0, 4.0]])
RNG = np.random.default_rng(0)


def white(poses: np.ndarray) -> Estimate:
    """Return navigation with independent errors of its edges, from a sure first pose."""
    n = len(poses)
    C, F = 1e-12 * np.eye(3 * n), np.eye(3)
    for i in range(1, n):
        dx, dy = poses[i, :2] - poses[i - 1, :2]
        F = np.array([[1, 0, -dy], [0, 1, dx], [0, 0, 1.0]])
        R = SE2(np.zeros(2), poses[i, 2]).adjoint()
        here, last = slice(3 * i, 3 * i + 3), slice(3 * i - 3, 3 * i)
        C[here, : 3 * i] = F @ C[last, : 3 * i]
        C[: 3 * i, here] = C[here, : 3 * i].T
        C[here, here] = F @ C[last, last] @ F.T + R @ np.diag(EDGE**2) @ R.T
    return Estimate(poses, C)


def closure(target: int, source: int, A: np.ndarray, pull: tuple[float, float], poses: np.ndarray = POSES) -> Closure:
    tie = Tie.at(poses, source, [target], None, LEVER)
    return Closure(tie, A, A @ np.array(pull), 0.01, np.array(pull))


def by_gtsam(navigation: Estimate, closures: list[Closure]) -> np.ndarray:
    """Return x, y and yaw (n, 3) of the same graph, solved by GTSAM."""
    poses = to_matrices(navigation.poses, TOY.truth)
    model = gtsam.noiseModel.Diagonal.Sigmas([1e-4, 1e-4, EDGE[2], EDGE[0], EDGE[1], 1e-3])
    graph = gtsam_search.hold({0: poses[0]})
    for node, T in enumerate(pose_graph.between(poses)):
        graph.add(gtsam.BetweenFactorPose3(node, node + 1, gtsam.Pose3(T), model))
    graph = gtsam_search.join(graph, *(gtsam_factor.between(c, TOY.truth) for c in closures))
    solved = gtsam_search.minimum(graph, gtsam_search.to_values(poses), gtsam_search.precise_search())
    assert solved is not None
    plane = from_matrices(solved)
    plane[:, 2] += navigation.poses[0, 2] - plane[0, 2]
    return plane


@pytest.mark.parametrize("A", [RIDGE, BOTH])
def test_poses_are_those_that_gtsam_finds_with_the_closures_as_between_factors(A: np.ndarray):
    navigation = white(POSES)
    closures = [closure(0, 7, A, (1.0, -0.5)), closure(2, 5, BOTH, (0.4, 0.3))]
    solved = solving.solve(navigation, closures)
    expected = by_gtsam(navigation, closures)
    assert np.abs(solved.poses - POSES)[:, :2].max() > 0.3
    assert solved.poses == pytest.approx(expected, abs=0.01)  # metres; edges' noise turns with the poses in GTSAM


def test_a_closure_without_rank_is_no_factor():
    none = closure(0, 7, np.zeros((0, 2)), (1.0, 1.0))
    assert gtsam_factor.between(none, TOY.truth).size() == 0
    navigation = white(POSES)
    assert solving.solve(navigation, [none]) is navigation


def test_several_targets_share_a_factor_s_information():
    tie = Tie.at(POSES, 7, [0, 1], np.array([0.3, 0.7]), LEVER)
    graph = gtsam_factor.between(Closure(tie, BOTH, np.zeros(2), 0.01, np.zeros(2)), TOY.truth)
    shifted = POSES.copy()
    shifted[7, :2] += [0.3, -0.2]
    values = gtsam_search.to_values(to_matrices(shifted, TOY.truth))
    expected = np.sum((BOTH @ [0.3, -0.2]) ** 2) / 2
    assert graph.size() == 2
    assert graph.error(values) == pytest.approx(expected, rel=1e-6)


def test_slopes_of_an_offset_are_its_changes():
    tie = Tie.at(POSES, 6, [0, 1, 3], np.array([0.5, 0.3, 0.2]), LEVER)
    there = POSES + RNG.normal(0, [1.0, 1.0, 0.05], POSES.shape)
    columns, J = tie.jacobian(there)
    for column, slope in zip(columns, J.T, strict=True):
        step = np.zeros(POSES.size)
        step[column] = 1e-6
        step = step.reshape(POSES.shape)
        assert (tie.offset(there + step) - tie.offset(there - step)) / 2e-6 == pytest.approx(slope, abs=1e-6)


def test_an_offset_is_nothing_at_its_time_and_a_motion_of_the_whole_map_leaves_it():
    tie = Tie.at(POSES, 6, [0, 1], None, LEVER)
    assert tie.offset(POSES) == pytest.approx(np.zeros(2))
    shifted = POSES + RNG.normal(0, [1.0, 1.0, 0.05], POSES.shape)
    whole = SE2(np.array([5.0, -3.0]), 0.7)
    turned = (whole @ SE2.from_vector(shifted)).to_vector()
    assert tie.offset(turned) == pytest.approx(tie.offset(shifted))


def test_the_variance_of_an_offset_is_that_of_drawn_poses():
    navigation = white(POSES)
    tie = Tie.at(POSES, 7, [0, 1], None, LEVER)
    draws = RNG.multivariate_normal(POSES.ravel(), navigation.covariance, 4000, method="eigh").reshape(4000, -1, 3)
    offsets = np.array([tie.offset(poses) for poses in draws])
    assert tie.variance(navigation) == pytest.approx(np.cov(offsets.T), rel=0.1, abs=0.02)


def test_one_closure_at_a_time_is_all_of_them_where_steps_are_small():
    navigation, closures = white(POSES), [closure(0, 7, BOTH, (0.05, -0.02)), closure(2, 5, RIDGE, (0.0, 0.03))]
    estimate = Estimate(POSES, navigation.covariance.copy())
    for one in closures:
        estimate = solving.updated(estimate, one)
    solved = solving.solve(navigation, closures)
    assert estimate.poses == pytest.approx(solved.poses, abs=1e-3)
    assert estimate.marginals == pytest.approx(solved.marginals, abs=1e-3)


def test_hundreds_of_closures_one_at_a_time_leave_a_covariance():
    estimate = Estimate(POSES, TOY.covariance.copy())
    for number in range(300):
        k, i = number % 4, 5 + number % 3
        estimate = solving.updated(estimate, closure(k, i, 15 * BOTH, (0.0, 0.0), estimate.poses))
    assert np.array_equal(estimate.covariance, estimate.covariance.T)
    assert np.linalg.eigvalsh(estimate.covariance)[0] > 0


def test_half_a_weight_is_half_the_information():
    navigation, whole = white(POSES), closure(0, 7, BOTH, (1.0, -0.5))
    half = dataclasses.replace(whole, A=whole.A / np.sqrt(2), c=whole.c / np.sqrt(2))
    weighted, scaled = solving.solve(navigation, [whole], np.array([0.5])), solving.solve(navigation, [half])
    assert weighted.poses == pytest.approx(scaled.poses, abs=1e-9)
    assert weighted.covariance == pytest.approx(scaled.covariance, abs=1e-9)


def test_graduated_non_convexity_leaves_out_what_contradicts_the_others():
    navigation = white(POSES)
    true = [closure(k, i, 10 * BOTH, (0.0, 0.0)) for k, i in ((0, 7), (0, 6), (1, 6), (1, 7), (2, 5))]
    false = closure(1, 6, 10 * BOTH, (3.0, 3.0))
    estimate, weights = solving.graduated(navigation, [*true, false], 0.999, 2.0)
    assert weights.tolist() == [1, 1, 1, 1, 1, 0]
    assert estimate.poses == pytest.approx(solving.solve(navigation, true).poses, abs=1e-6)
    assert (solving.graduated(navigation, true, 0.999, 2.0)[1] == 1).all()


def test_the_gate_s_chi2_is_that_against_a_graph_without_the_closure():
    navigation = white(POSES)
    closures = [closure(0, 7, BOTH, (0.5, 0.1)), closure(0, 6, RIDGE, (0.0, 0.4)), closure(1, 7, BOTH, (0.2, 0.6))]
    J, r = linearised(closures, POSES)
    inverse = np.linalg.inv(J @ np.asarray((J @ navigation.covariance).T) + np.eye(len(r)))
    pull = inverse @ r
    rows = slice(0, 2)
    without = solving.solve(navigation, closures[1:])
    expected = factor.chi2(
        factor.Factor(closures[0].A, closures[0].c, np.ones(2)),
        closures[0].tie.offset(without.poses),
        closures[0].tie.variance(without),
    )
    assert pull[rows] @ np.linalg.solve(inverse[rows, rows], pull[rows]) == pytest.approx(expected, rel=0.01)


def test_a_larger_drift_excuses_a_closure_that_the_believed_one_does_not():
    navigation = white(POSES)
    far = [closure(0, 7, BOTH, (0.0, 6 * float(np.sqrt(navigation.covariance[-2, -2]))))]
    verdicts = [gates.by_prediction(navigation, far, factor.Settings(drift_factor=times))[0] for times in (1.0, 3.0)]
    assert verdicts == [False, True]


def test_matrices_and_planes_are_each_other_s_inverse():
    poses = closable.moved(TOY.truth, RNG.normal(0, [1, 1, 0.1], (len(TOY.truth), 3)))
    assert to_matrices(from_matrices(poses), TOY.truth) == pytest.approx(poses)


def test_a_covariance_of_other_poses_is_refused():
    with pytest.raises(ClosingError, match="must be"):
        Estimate(POSES, np.eye(3))
