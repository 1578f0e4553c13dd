"""Loops closed on all cores, and drift as large as closures say."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import closable
from closable import Toy
from pointnetkl.correction.preparation.cut import Clouds
from pointnetkl.correction.preparation.reference import Reference
from pointnetkl.correction.solution import closing
from pointnetkl.correction.solution.belief import Navigation
from pointnetkl.correction.solution.closing import Problem
from pointnetkl.slam.closing import drift, survey
from pointnetkl.slam.closing.estimate import Closure, Estimate, Tie, from_matrices
from pointnetkl.slam.closing.survey import Closed
from pointnetkl.surveys import pose


@pytest.fixture(scope="module")
def hills() -> Toy:
    return closable.sail("hills")


def problem(folder: Path, toy: Toy, poses: np.ndarray, rates: drift.Settings, reference: Reference | None = None):
    path = folder / "points.f32"
    path.write_bytes(b"".join(cloud.astype("<f4").tobytes() for cloud in toy.clouds))
    clouds = Clouds(path, [len(cloud) for cloud in toy.clouds])
    plane = from_matrices(poses)
    fix = None if rates.position_walk_m else drift.Fix(float(toy.time_s[0]), *plane[0, :2].tolist())
    navigation = Navigation(toy.time_s, plane, rates, fix)
    settings = survey.Settings(rounds=2)
    return Problem(clouds, poses, navigation, closable.SPACING_M, settings, closable.REGISTRATION, (), reference)


def known(folder: Path, toy: Toy) -> Reference:
    """Return the points of the first line's submaps, where they truly are, as a reference."""
    points = np.concatenate([pose.transform(T, cloud) for T, cloud in zip(toy.truth[:4], toy.clouds[:4], strict=True)])
    np.save(folder / "known.npy", points[np.argsort(points[:, 0])])
    return Reference(folder / "known.npy")


def assert_same(one: Closed, other: Closed) -> None:
    np.testing.assert_array_equal(one.poses, other.poses)
    np.testing.assert_array_equal(one.estimate.covariance, other.estimate.covariance)
    assert [(f.source, list(f.targets), f.state) for f in one.found] == [
        (f.source, list(f.targets), f.state) for f in other.found
    ]


@pytest.mark.parametrize("chunk", [1, 5])
def test_the_result_does_not_depend_on_chunks(tmp_path: Path, hills: Toy, chunk: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    asked = problem(tmp_path, hills, hills.drifted(0), closable.DRIFT, known(tmp_path, hills))
    alone, _ = closing.close(asked, measure_drift=False)
    monkeypatch.setattr(closing, "_SEVERAL", 2)
    monkeypatch.setattr(closing, "_CHUNK", chunk)
    assert_same(closing.close(asked, measure_drift=False)[0], alone)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["known.npy", "points.f32"]


@pytest.mark.slow
def test_the_result_does_not_depend_on_workers(tmp_path: Path, hills: Toy, monkeypatch: pytest.MonkeyPatch):
    asked = problem(tmp_path, hills, hills.drifted(0), closable.DRIFT, known(tmp_path, hills))
    monkeypatch.setattr(closing, "_SEVERAL", 2)
    monkeypatch.setattr(closing, "_CHUNK", 3)
    closed = []
    for workers in ("1", "2"):
        monkeypatch.setenv("POINTNETKL_WORKERS", workers)
        closed.append(closing.close(asked, measure_drift=False)[0])
    assert_same(*closed)


def test_a_reference_ties_submaps_to_the_map(tmp_path: Path, hills: Toy):
    asked = problem(tmp_path, hills, hills.drifted(0), closable.DRIFT, known(tmp_path, hills))
    closed, _ = closing.close(asked, measure_drift=False)
    on_map = [f for f in closed.found if not f.targets]
    assert {f.source for f in on_map} >= {0, 1, 2, 3}
    assert closable.rms(closed.poses[:4], hills.truth[:4]) < 0.2


def test_rates_that_are_given_stay(tmp_path: Path, hills: Toy):
    asked = problem(tmp_path, hills, hills.drifted(0), closable.DRIFT.times(0.1))
    assert closing.close(asked, measure_drift=False)[1] == closable.DRIFT.times(0.1)


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_measured_drift_comes_near_the_true_one(tmp_path: Path, hills: Toy, factor: float):
    scales = []
    for seed in range(2):
        asked = problem(tmp_path, hills, hills.drifted(seed), closable.DRIFT.times(factor))
        _, rates = closing.close(asked, measure_drift=True)
        scales.append(rates.heading_walk_rad / closable.DRIFT.heading_walk_rad)  # what is constant is never made surer
    assert 0.4 < np.exp(np.mean(np.log(scales))) < 2.5


def test_the_likely_scale_is_that_of_the_drift_in_the_long_run(hills: Toy):
    poses = from_matrices(hills.truth)
    estimate = Estimate(poses, hills.covariance)
    for true in (0.3, 1.0, 4.0):
        scales = []
        for seed in range(10):
            rng = np.random.default_rng(seed)
            errors = rng.multivariate_normal(np.zeros(len(hills.covariance)), hills.covariance).reshape(-1, 3)
            drifted = poses + true * errors
            ties = [Tie.at(poses, k, [k - 4, k - 5], None, np.zeros(2)) for k in range(5, 12)]
            ends = [tie.offset(poses) - tie.offset(drifted) + 0.05 * rng.standard_normal(2) for tie in ties]
            A = np.eye(2) / 0.05
            scales.append(
                closing.likely_scale(estimate, [Closure(t, A, A @ e, 1e-3, e) for t, e in zip(ties, ends, strict=True)])
            )
        assert np.exp(np.mean(np.log(scales))) == pytest.approx(true, rel=0.5)


@pytest.mark.parametrize("factor", [1e-8, 1e8])
def test_drift_is_measured_within_what_rates_may_be(
    tmp_path: Path, hills: Toy, factor: float, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(Closed, "variance_factor", property(lambda _: factor))
    for name in ("compass", "usbl"):
        asked = problem(tmp_path, hills, hills.drifted(0), drift.PRESETS[name])
        closing.close(asked, measure_drift=True)


def test_absolute_navigation_is_never_measured_to_be_surer_than_it_says(tmp_path: Path, hills: Toy):
    # closures see how passes differ, and nothing of an error that all passes share
    for name in ("gnss", "usbl"):
        asked = problem(tmp_path, hills, hills.truth, drift.PRESETS[name])
        _, rates = closing.close(asked, measure_drift=True)
        assert rates.position_walk_m >= drift.PRESETS[name].position_walk_m


def test_a_few_closures_measure_nothing(tmp_path: Path):
    short = closable.sail("hills", lines=1)
    asked = problem(tmp_path, short, short.truth, closable.DRIFT)
    closed, rates = closing.close(asked, measure_drift=True)
    assert rates == closable.DRIFT
    assert list(closed.found) == []


def test_what_is_kept_for_workers_is_of_the_round_at_hand(hills: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    monkeypatch.setattr(closing, "_SEVERAL", 2)
    stored: list[Sequence[Path]] = []
    registered = closing._registered

    def watched(path: Path, *rest: object) -> object:
        found = registered(path, *rest)  # type: ignore[arg-type]
        stored.append(list(closing._LOADED))
        return found

    monkeypatch.setattr(closing, "_registered", watched)
    closing.close(problem(tmp_path, hills, hills.drifted(0), closable.DRIFT), measure_drift=False)
    assert stored
    assert {len(paths) for paths in stored} == {1}
