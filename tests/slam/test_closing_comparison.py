"""Table V's runs: every method on the same ends, the same gates, and drifts that are what they are said to be."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import closable
from drifts import of_vehicle
from pointnetkl.registration.covariance import catalogue
from pointnetkl.simulation import vehicle
from pointnetkl.slam.closing import comparison, drift, schemas
from pointnetkl.slam.closing.comparison import Results, Settings, Track
from pointnetkl.slam.closing.estimate import ClosingError, Estimate, Tie
from pointnetkl.workflow import artifacts, parameters
from simulated_survey import PARAMS

SETTINGS = Settings(seed=1, drifts=2, believed=[1.0, 3.0])


def track(kind: str = "hills") -> Track:
    toy = closable.sail(kind)
    start = drift.Fix(float(toy.time_s[0]) - 10, *toy.truth[0, :2, 3].tolist())
    return Track(
        survey="toy",
        number=np.arange(len(toy.truth)) + 100,
        clouds=toy.clouds,
        navigation=toy.drifted(0),
        truth=toy.truth,
        time_s=toy.time_s,
        fix=start,
        drift=closable.DRIFT,
        spacing_m=closable.SPACING_M,
    )


def rivals(n: int) -> dict[str, np.ndarray]:
    split = np.tile(0.01 * np.eye(2), (n, 1, 1))
    split[n - 1] = np.nan  # it was never measured
    return {catalogue.CONSTANT: np.tile(np.eye(2), (n, 1, 1)), catalogue.SPLIT: split}


@pytest.fixture(scope="module")
def results() -> Results:
    sailed = track()
    return comparison.compare(sailed, rivals(len(sailed.number)), SETTINGS, closable.REGISTRATION)


def test_every_run_has_every_method_once(results: Results):
    rows = results.rows
    assert list(rows.columns) == schemas.ROWS.names
    assert not rows.duplicated(["run", "believed", "method"]).any()
    first = rows[(rows["run"] == 0) & (rows["believed"] == 1.0)]["method"].tolist()
    assert first == ["navigation", "constant", "split", "pair", "map"]
    assert rows[rows["believed"] == 3.0]["method"].unique().tolist() == ["map"]
    assert sorted(rows["run"].unique()) == [0, 1, 2]


def test_map_beats_navigation_in_every_run(results: Results):
    by_method = results.rows[results.rows["believed"] == 1.0].pivot(index="run", columns="method", values="as_it_is_m")
    assert (by_method["map"] < 0.8 * by_method["navigation"]).all()


def test_a_source_without_a_covariance_is_unmatched(results: Results):
    run = results.rows[(results.rows["run"] == 0) & (results.rows["believed"] == 1.0)].set_index("method")
    assert run.loc["split", "closures"] == run.loc["constant", "closures"]
    assert run.loc["split", "flat"] == run.loc["constant", "flat"] == 0
    sailed = track()
    by_pair = closable.sail("hills").close(sailed.navigation)
    split = rivals(len(sailed.number))[catalogue.SPLIT]
    states = {f.source: f.state for f in comparison.survey.with_covariances(by_pair, split, SETTINGS.closing).found}
    assert states[len(sailed.number) - 1] == schemas.State.UNMATCHED


def test_navigation_has_errors_and_no_closures(results: Results):
    before = results.rows[results.rows["method"] == "navigation"]
    assert len(before) == 3
    assert before[["closures", "accepted", "flat", "variance_factor"]].isna().all(axis=None)
    assert before[[*schemas.ERRORS, "pose_nees", "joined_95"]].notna().all(axis=None)


def test_drifts_are_drawn_about_a_truth_that_lies_elsewhere():
    sailed = track()
    away = sailed.truth.copy()
    away[:, 0, 3] += 200.0  # another datum
    there = comparison.drawn(dataclasses.replace(sailed, truth=away), 1, 5)
    here = comparison.drawn(sailed, 1, 5)
    assert there.covariance(1.0) == pytest.approx(here.covariance(1.0), rel=1e-6, abs=1e-9)
    offsets = [(drawn.navigation - truth)[:, :2, 3] for drawn, truth in ((there, away), (here, sailed.truth))]
    assert np.hypot(*offsets[0].T).max() < 3 * np.hypot(*offsets[1].T).max() < 30.0


def test_poses_and_closures_are_of_the_recorded_navigation_by_map(results: Results, tmp_path: Path):
    poses, closures = results.poses, results.closures
    assert list(poses.columns) == schemas.POSES.names
    assert list(closures.columns) == schemas.CLOSURES.names
    assert poses["submap"].tolist() == list(range(100, 100 + len(poses)))
    truth = track().truth
    rms = np.sqrt(np.mean((poses["x_m"] - truth[:, 0, 3]) ** 2 + (poses["y_m"] - truth[:, 1, 3]) ** 2))
    run = results.rows[(results.rows["run"] == 0) & (results.rows["method"] == "map")].iloc[0]
    assert rms == pytest.approx(run["as_it_is_m"], rel=1e-9)
    for name, table, schema in (("r", results.rows, schemas.ROWS), ("c", closures, schemas.CLOSURES)):
        artifacts.write_table(tmp_path / f"{name}.parquet", table, schema, {})
        assert len(artifacts.read_table(tmp_path / f"{name}.parquet", schema)) == len(table)
    shares = closures.groupby("source")["share"].sum()
    assert shares.to_numpy() == pytest.approx(np.ones(len(shares)))
    assert (closures["target"] < closures["source"] - 1).all()


def test_drawn_drifts_have_the_covariance_that_is_believed():
    sailed = track()
    errors = np.array(
        [(comparison.drawn(sailed, run, 5).navigation - sailed.truth)[:, :2, 3].ravel() for run in range(1, 400)]
    )
    kept = np.ravel([[3 * k, 3 * k + 1] for k in range(len(sailed.number))])
    believed = dataclasses.replace(sailed, navigation=sailed.truth).covariance(1.0)[np.ix_(kept, kept)]
    nees = np.einsum("ri,ij,rj->r", errors, np.linalg.pinv(believed, 1e-12), errors) / len(kept)
    assert nees.mean() == pytest.approx(1.0, abs=0.1)
    assert comparison.drawn(sailed, 0, 5) is sailed


@pytest.mark.parametrize(("believed", "share"), [(1.0, 0.95), (1 / 3, 0.28)])  # of chi2 with 2 degrees: 5.99, 5.99 / 9
def test_ellipses_of_the_poses_hold_the_errors_of_pairs_that_they_say(believed: float, share: float):
    sailed = track()
    within = []
    for run in range(1, 200):
        drawn = comparison.drawn(sailed, run, 5)
        start = Estimate(comparison.from_matrices(drawn.navigation), drawn.covariance(believed))
        last = len(drawn.number) - 1
        tie = Tie.at(start.poses, last, [0, last // 2], np.array([0.3, 0.7]), np.array([2.0, -1.0]))
        within.append(comparison.errors(drawn.navigation, start, drawn.truth, [tie])["joined_95"])
    assert np.mean(within) == pytest.approx(share, abs=0.06)


@pytest.mark.parametrize("truly", [1.0, 3.0])
def test_the_variance_factor_tells_how_far_drift_is_understated(truly: float):
    sailed = track()
    drifting = dataclasses.replace(sailed, drift=closable.DRIFT.times(truly))
    factors = []
    for run in range(1, 7):
        navigation = comparison.drawn(drifting, run, 2).navigation
        closed = closable.sail("hills").close(navigation)
        factors.append(closed.variance_factor)
    assert 0.3 * truly**2 < np.median(factors) < 2.5 * truly**2


def test_without_closures_there_is_no_variance_factor():
    flat = closable.sail("flat")
    closed = flat.close(flat.truth)
    assert np.isnan(closed.variance_factor)


def test_the_same_seed_draws_the_same_drift():
    sailed = track()
    one, same, other = (comparison.drawn(sailed, *key).navigation for key in ((1, 5), (1, 5), (1, 6)))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_without_a_truth_the_recorded_navigation_is_closed_and_no_error_known():
    sailed = track()
    unknown = dataclasses.replace(sailed, truth=np.full_like(sailed.truth, np.nan))
    found = comparison.compare(unknown, {}, SETTINGS, closable.REGISTRATION)
    assert found.rows["run"].tolist() == [0] * len(found.rows)
    assert found.rows[[*schemas.ERRORS, "pose_nees", "joined_95"]].isna().all(axis=None)
    assert (found.rows["accepted"] > 0).any()


def test_a_covariance_turns_with_its_submap():
    sailed = track()
    closed = closable.sail("hills").close(sailed.navigation)
    closure = next(f.closure for f in closed.found if f.closure is not None and abs(f.closure.tie.tied_source[2]) > 3)
    n = len(sailed.number)
    along = np.tile(np.diag([4.0, 0.01]), (n, 1, 1))
    turned = closable.moved(closed.poses, np.tile([0.0, 0.0, np.pi / 2], (n, 1)))
    for poses, axis in ((closed.poses, 0), (turned, 1)):
        tie = dataclasses.replace(closure.tie, tied_source=comparison.from_matrices(poses)[closure.tie.source])
        found = dataclasses.replace(closed.found[0], closure=dataclasses.replace(closure, tie=tie), source=tie.source)
        one = dataclasses.replace(closed, found=[found])
        weighted = comparison.survey.with_covariances(one, along, SETTINGS.closing).found[0].closure
        assert weighted is not None
        Q = np.linalg.inv(weighted.A.T @ weighted.A)
        assert Q[axis, axis] == pytest.approx(4.0, rel=0.02)
        assert weighted.A @ closure.end == pytest.approx(weighted.c)


def test_a_covariance_that_is_none_is_refused():
    closed = closable.sail("hills").close(track().navigation)
    wrong = np.tile(-np.eye(2), (len(closed.poses), 1, 1))
    with pytest.raises(ClosingError, match="must be positive definite"):
        comparison.survey.with_covariances(closed, wrong, SETTINGS.closing)


@pytest.mark.parametrize(
    "wrong", [{"drifts": -1}, {"believed": []}, {"believed": [1.0, 0.0]}, {"believed": [1.0, 1.0]}, {"seed": -1}]
)
def test_settings_out_of_range_are_refused(wrong: dict):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        dataclasses.replace(SETTINGS, **wrong)


def test_rates_go_by_the_name_that_a_survey_gives():
    stated = {"simulated": closable.DRIFT}
    assert drift.named("simulated", stated) is closable.DRIFT
    assert drift.named("compass", stated) is drift.PRESETS["compass"]
    with pytest.raises(drift.DriftError, match=r"mine is 'gps', must be one of .* gnss, usbl, simulated; or"):
        drift.named("gps", stated, "mine")


def test_simulated_rates_are_those_that_section_vehicles_sails():
    stated = parameters.read(PARAMS, "navigation", dict[str, drift.Settings])
    for name in parameters.read(PARAMS, "vehicles", dict):
        sails = of_vehicle(parameters.read(PARAMS, f"vehicles.{name}", vehicle.Settings).navigation)
        assert dataclasses.astuple(stated["simulated"]) == pytest.approx(dataclasses.astuple(sails), rel=1e-3)


def test_a_submap_without_a_match_is_a_row_that_can_be_read_again(tmp_path: Path):
    sailed = track()
    closed = closable.sail("hills").close(sailed.navigation)
    found = [dataclasses.replace(closed.found[0], closure=None, state=schemas.State.UNMATCHED), *closed.found[1:]]
    closures = comparison.closures(sailed, dataclasses.replace(closed, found=found))
    artifacts.write_table(tmp_path / "closures.parquet", closures, schemas.CLOSURES, {})
    rows = artifacts.read_table(tmp_path / "closures.parquet", schemas.CLOSURES)
    first = rows[rows["source"] == 100 + closed.found[0].source]
    assert first["state"].tolist() == ["unmatched"] * len(closed.found[0].targets)
    assert (first["rank"] == 0).all()
    assert first["residual_m"].isna().all()
