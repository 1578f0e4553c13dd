"""A survey closed from its own navigation: what the ground holds is corrected, and nothing else is touched."""

import dataclasses

import numpy as np
import pytest

import closable
from closable import Toy
from pointnetkl.slam.closing import gates, search, survey
from pointnetkl.slam.closing.estimate import ClosingError, Estimate, from_matrices
from pointnetkl.slam.closing.schemas import State
from pointnetkl.slam.closing.survey import Closed

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
