"""A survey closed from its own navigation: what the ground holds is corrected, and nothing else is touched."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import closable
from closable import Toy
from pointnetkl.slam.closing import gates, search, survey
from pointnetkl.slam.closing.estimate import ClosingError, Closure, Estimate, Tie, from_matrices, to_matrices
from pointnetkl.slam.closing.schemas import State
from pointnetkl.slam.closing.survey import Closed, Found
from pointnetkl.surveys import pose

SETTINGS = survey.Settings()
HELD = [1e-3, 1e-3, 1e-9]


@pytest.fixture(scope="module")
def hills() -> Toy:
    return closable.sail("hills")


@pytest.fixture(scope="module")
def closed(hills: Toy) -> Closed:
    return hills.close(hills.drifted(0))


def ground(toy: Toy, navigation: np.ndarray) -> search.Ground:
    return search.Ground(toy.clouds, navigation, closable.SPACING_M, closable.REGISTRATION, SETTINGS.search)


@pytest.mark.parametrize("factor", [0.3, 1.0, 3.0])
def test_on_flat_ground_poses_stay_where_they_were(factor: float):
    flat = closable.sail("flat")
    for seed in range(2):
        navigation = flat.drifted(seed)
        closed = flat.close(navigation, factor)
        assert len(closed.found) > 4
        assert {f.state for f in closed.found} == {State.FLAT}
        assert closed.poses == pytest.approx(navigation, abs=1e-9)
        assert closed.rounds == 2


@pytest.mark.parametrize("factor", [0.3, 1.0, 3.0])
def test_on_hills_errors_fall(hills: Toy, factor: float):
    before, after = [], []
    for seed in range(3):
        navigation = hills.drifted(seed)
        before.append(closable.rms(navigation, hills.truth))
        after.append(closable.rms(hills.close(navigation, factor).poses, hills.truth))
    assert np.mean(after) < 0.7 * np.mean(before)
    assert (np.array(after) < 1.02 * np.array(before)).all()


def test_pairs_that_closures_join_agree_better_than_navigation_s(hills: Toy, closed: Closed):
    truth, after, before = (from_matrices(T) for T in (hills.truth, closed.poses, hills.drifted(0)))

    def miss(poses: np.ndarray) -> float:
        offsets = [closure.tie.offset(poses) - closure.tie.offset(truth) for closure in closed.accepted]
        return float(np.sqrt(np.mean(np.sum(np.square(offsets), axis=1))))

    assert len(closed.accepted) >= 4
    assert miss(after) < min(0.15, 0.3 * miss(before))


def test_a_ridge_corrects_only_across():
    ridge = closable.sail("ridge")
    shift = np.zeros((len(ridge.truth), 3))
    shift[2 * closable.ALONG :, :2] = [1.5, 1.5]  # the last line, off along the ridge and across
    navigation = closable.moved(ridge.truth, shift)
    closed = ridge.close(navigation, 3.0)
    miss = (closed.poses - ridge.truth)[2 * closable.ALONG :, :2, 3].mean(axis=0)
    assert {closure.rank for closure in closed.accepted} == {1}
    assert miss[0] == pytest.approx(1.5, abs=0.25)  # directions err by up to 11 degrees: 0.3 m along for 1.5 m across
    assert abs(miss[1]) < 0.4
    assert all(abs(closure.A[0, 0]) < 0.2 * abs(closure.A[0, 1]) for closure in closed.accepted)


def test_little_of_a_wrong_start_is_kept(hills: Toy):
    source, on = 2 * closable.ALONG + 1, [1, 2, closable.ALONG + 1, closable.ALONG + 2]
    places = {}
    for start in (-3.0, 3.0):
        for axis in (0, 1):
            shift = np.zeros((len(hills.truth), 3))
            shift[source, axis] = start
            navigation = closable.moved(hills.truth, shift)
            believed = Estimate(from_matrices(navigation), hills.covariance)
            closure = search.register(ground(hills, navigation), believed, source, on)
            assert closure is not None
            assert closure.rank == 2
            places[start, axis] = shift[source, :2] + np.linalg.solve(closure.A, closure.c)
    for axis in (0, 1):
        kept = (places[3.0, axis] - places[-3.0, axis])[axis] / 6.0
        assert abs(kept) < 0.2


def wrong_by(found: list[survey.Found], k: int, offset_m: np.ndarray) -> list[survey.Found]:
    """Return closures of which one registered at a place that is wrong by an offset (2,)."""
    closure = found[k].closure
    assert closure is not None
    shifted = dataclasses.replace(closure, c=closure.c + closure.A @ offset_m)
    return [*found[:k], dataclasses.replace(found[k], closure=shifted), *found[k + 1 :]]


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_a_wrong_end_of_10_m_is_refused(hills: Toy, closed: Closed, factor: float):
    navigation = Estimate(closed.navigation.poses, hills.of_drift(factor))
    clean = survey.judge(navigation, closed.found, SETTINGS)[1]
    for k in range(0, len(closed.found), 2):
        for direction in np.array([[10.0, 0.0], [0.0, -10.0]]):
            judged, estimate = survey.judge(navigation, wrong_by(list(closed.found), k, direction), SETTINGS)
            assert judged[k].state in (State.PREDICTION, State.OUTVOTED)
            assert sum(f.state != State.ACCEPTED for f in judged) <= 2
            assert np.abs(estimate.poses - clean.poses)[:, :2].max() < 0.5


def test_a_quarter_of_wrong_ends_is_refused_too(hills: Toy, closed: Closed):
    found = list(closed.found)
    wrong = list(range(0, len(found), 4))
    for k in wrong:
        found = wrong_by(found, k, np.array([8.0, 8.0 * (-1) ** k]))
    judged, estimate = survey.judge(closed.navigation, found, SETTINGS)
    assert all(judged[k].state != State.ACCEPTED for k in wrong)
    assert np.abs(estimate.poses - closed.estimate.poses)[:, :2].max() < 0.5


def test_matches_that_fit_badly_are_refused(closed: Closed):
    found = list(closed.found)
    closure = found[3].closure
    assert closure is not None
    worse = dataclasses.replace(closure, residual_variance=4 * closure.residual_variance)
    found[3] = dataclasses.replace(found[3], closure=worse)
    assert survey.judge(closed.navigation, found, SETTINGS)[0][3].state == State.RESIDUALS


def test_poses_are_as_sure_as_they_are_right(hills: Toy):
    squares = []
    for seed in range(6):
        closed = hills.close(hills.drifted(seed), settings=survey.Settings(rounds=1))
        errors = (closed.poses - hills.truth)[:, :2, 3]
        marginals = closed.estimate.marginals[:, :2, :2]
        squares += [e @ np.linalg.solve(Q, e) / 2 for e, Q in zip(errors, marginals, strict=True)]
    assert 0.3 < np.mean(squares) < 2


def test_closures_make_poses_surer_and_never_less_sure(closed: Closed):
    before, after = (np.trace(e.marginals[:, :2, :2], axis1=1, axis2=2) for e in (closed.navigation, closed.estimate))
    assert (after <= before * (1 + 1e-9)).all()
    assert after[-1] < 0.7 * before[-1]


def test_a_submap_is_never_closed_with_the_one_just_before(closed: Closed):
    assert closed.found
    assert all(max(f.targets) < f.source - 1 for f in closed.found)


def test_the_expected_overlap_falls_where_the_place_is_unsure(hills: Toy):
    source = 2 * closable.ALONG + 1
    there = ground(hills, hills.truth)
    sure, unsure = (
        search.targets(there, Estimate(from_matrices(hills.truth), factor**2 * hills.covariance), source)
        for factor in (1.0, 100.0)
    )
    assert len(sure) >= 2
    assert len(unsure) < len(sure)


def test_gates_of_no_closures_pass_none(closed: Closed):
    assert not len(gates.by_residuals([], SETTINGS.search.gates))
    assert not len(gates.by_prediction(closed.navigation, [], SETTINGS.search.gates))


def test_registrations_of_yaw_are_refused(hills: Toy):
    registration = dataclasses.replace(closable.REGISTRATION, dof="xyyaw")
    with pytest.raises(ClosingError, match="dof to xy"):
        survey.close(hills.clouds, hills.truth, hills.covariance, 2.0, SETTINGS, registration)


def test_poses_without_clouds_are_refused(hills: Toy):
    with pytest.raises(ClosingError, match="one each"):
        survey.close(hills.clouds[1:], hills.truth, hills.covariance, 2.0, SETTINGS, closable.REGISTRATION)


def on_map(toy: Toy, k: int, offset: np.ndarray, sigma_m: float = 0.01) -> Closure:
    """Return the tie that moves the middle of submap k by an offset (2,) on the map."""
    tie, A = Tie.at(from_matrices(toy.truth), k, [], np.empty(0), np.array([10.0, -5.0])), np.eye(2) / sigma_m
    return Closure(tie, A, A @ offset, sigma_m**2, offset)


def test_a_tie_to_the_map_has_the_offset_of_its_lever_on_the_map(hills: Toy):
    poses = from_matrices(hills.truth)
    tie = Tie.at(poses, 5, [], np.empty(0), np.array([10.0, -5.0]))
    assert tie.offset(poses) == pytest.approx([0, 0])
    moved = poses.copy()
    moved[5] += [2.0, 3.0, np.pi / 2]
    at = poses[5, 2]
    arm = np.array([10 * np.cos(at) + 5 * np.sin(at), 10 * np.sin(at) - 5 * np.cos(at)])
    assert tie.offset(moved) == pytest.approx([2.0 - arm[1] - arm[0], 3.0 + arm[0] - arm[1]])
    others = moved.copy()
    others[[0, 4, 6]] += 100.0
    assert tie.offset(others) == pytest.approx(tie.offset(moved))


def test_slopes_of_a_tie_to_the_map_are_those_of_its_offset(hills: Toy):
    poses = from_matrices(hills.drifted(0))
    tie = Tie.at(from_matrices(hills.truth), 5, [], np.empty(0), np.array([10.0, -5.0]))
    columns, J = tie.jacobian(poses)
    assert columns.tolist() == [15, 16, 17]
    for k in range(3):
        step = np.zeros_like(poses)
        step[5, k] = 1e-6
        assert J[:, k] == pytest.approx((tie.offset(poses + step) - tie.offset(poses - step)) / 2e-6, abs=1e-6)


def test_a_tie_to_the_map_is_as_unsure_as_its_submap(hills: Toy):
    estimate = Estimate(from_matrices(hills.truth), hills.covariance)
    tie = Tie.at(estimate.poses, 5, [], np.empty(0), np.zeros(2))
    assert tie.variance(estimate) == pytest.approx(estimate.marginals[5, :2, :2])


def test_anchors_correct_navigation_before_any_closure(hills: Toy):
    offset = np.array([1.5, -1.0])
    anchors = [on_map(hills, k, offset) for k in range(len(hills.truth))]
    closed = survey.close(
        hills.clouds, hills.truth, hills.of_drift(30.0), 2.0, SETTINGS, closable.REGISTRATION, anchors
    )
    moved = np.tile([1.5, -1.0], (len(hills.truth), 1))
    assert (closed.navigation.poses - from_matrices(hills.truth))[:, :2] == pytest.approx(moved, abs=0.1)
    assert (closed.poses - hills.truth)[:, :2, 3] == pytest.approx(moved, abs=0.1)
    assert np.sqrt(closed.estimate.marginals[:, 0, 0]).max() < 0.05


def test_anchors_hold_where_there_are_no_closures():
    flat = closable.sail("flat")
    closed = survey.close(
        flat.clouds,
        flat.truth,
        flat.of_drift(30.0),
        2.0,
        SETTINGS,
        closable.REGISTRATION,
        [on_map(flat, 11, np.array([2.0, 0.0]))],
    )
    assert closed.accepted == []
    assert (closed.poses - flat.truth)[11, :2, 3] == pytest.approx([2.0, 0.0], abs=0.3)
    np.testing.assert_array_equal(closed.estimate.poses, closed.navigation.poses)


def reference(toy: Toy, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the points of all submaps where they truly are."""
    points = np.concatenate([pose.transform(T, cloud) for T, cloud in zip(toy.truth, toy.clouds, strict=True)])
    return points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)]


def test_a_reference_takes_out_a_shift_of_the_whole_survey(hills: Toy):
    shift = np.tile([2.0, -1.5, 0.0], (len(hills.truth), 1))
    navigation = closable.moved(hills.truth, shift)
    covariance = hills.of_drift(1.0) + np.kron(np.ones((12, 12)), np.diag([9.0, 9.0, 0.0]))
    closed = survey.close(
        hills.clouds,
        navigation,
        covariance,
        2.0,
        SETTINGS,
        closable.REGISTRATION,
        reference=lambda low, high: reference(hills, low, high),
    )
    assert closable.rms(closed.poses, hills.truth) < 0.15
    own = [f for f in closed.found if not f.targets]
    assert [f.source for f in own] == list(range(12))
    assert {f.state for f in own} == {State.ACCEPTED}
    without = survey.close(hills.clouds, navigation, covariance, 2.0, SETTINGS, closable.REGISTRATION)
    assert closable.rms(without.poses, hills.truth) == pytest.approx(2.5, abs=0.1)


def test_where_there_is_no_reference_there_is_no_closure_on_it(hills: Toy):
    closed = survey.close(
        hills.clouds,
        hills.truth,
        hills.covariance,
        2.0,
        SETTINGS,
        closable.REGISTRATION,
        reference=lambda low, high: np.empty((0, 3)),
    )
    assert all(f.targets for f in closed.found)


def test_another_way_to_register_a_round_gives_the_same(hills: Toy, closed: Closed):
    rounds = []

    def backwards(ground: search.Ground, estimate: Estimate) -> list[Found]:
        rounds.append(len(estimate.poses))
        return [f for k in reversed(range(12)) for f in survey.registered_at(ground, estimate, [k])][::-1]

    navigation = hills.drifted(0)
    again = survey.close(
        hills.clouds, navigation, hills.covariance, 2.0, SETTINGS, closable.REGISTRATION, over=backwards
    )
    np.testing.assert_array_equal(again.poses, closed.poses)
    assert len(rounds) == again.rounds - 1 == closed.rounds - 1


def test_submaps_registered_one_by_one_are_those_registered_together(hills: Toy):
    there, estimate = ground(hills, hills.drifted(0)), Estimate(from_matrices(hills.drifted(0)), hills.covariance)
    together = survey.registered_at(there, estimate)
    apart = [f for k in range(12) for f in survey.registered_at(there, estimate, [k])]
    assert [f.source for f in apart] == [f.source for f in together]
    for one, other in zip(apart, together, strict=True):
        assert one.closure is not None
        assert other.closure is not None
        np.testing.assert_array_equal(one.closure.c, other.closure.c)


def test_a_closure_says_how_many_points_it_is_of(closed: Closed):
    for f in closed.found:
        assert f.closure is not None
        assert 20 <= f.closure.points <= 1500


def tilted_poses(toy: Toy) -> np.ndarray:
    """Return the true poses with a roll and a pitch."""
    angles = np.random.default_rng(4).normal(0, 0.1, (len(toy.truth), 2))
    poses = toy.truth.copy()
    poses[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_euler("yx", angles).as_matrix()
    return poses


def test_poses_that_do_not_move_stay_to_the_last_digit_but_rounding(hills: Toy):
    tilted = tilted_poses(hills)
    assert to_matrices(from_matrices(tilted), tilted) == pytest.approx(tilted, abs=1e-12)


def test_moved_poses_keep_depth_roll_and_pitch(hills: Toy):
    tilted = tilted_poses(hills)
    plane = from_matrices(tilted) + np.array([3.0, -2.0, 0.7])
    moved = to_matrices(plane, tilted)
    assert from_matrices(moved) == pytest.approx(plane)
    np.testing.assert_array_equal(moved[:, 2, 3], tilted[:, 2, 3])
    assert moved[:, 2, :3] == pytest.approx(tilted[:, 2, :3])  # the map's vertical, in the submap's frame
