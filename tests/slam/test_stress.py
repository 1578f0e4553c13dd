"""The benchmark of wrong loop closures: which are false, and what each estimator makes of them."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.graph import pose_graph
from pointnetkl.slam.graph.pose_graph import PoseGraph
from pointnetkl.slam.robust import estimators, false_closures, loop_gate, stress
from pointnetkl.slam.robust import schemas as robust_schemas
from pointnetkl.workflow import artifacts, parameters
from toy_survey import SETTINGS as GRAPH_SETTINGS
from toy_survey import SPACING, graph

SUBMAPS, GRAPH = graph(4, 4, apart=6.0)
THRESHOLDS = estimators.Thresholds(1.345, 1.0, 1.0, 0.99, 2.0)
SETTINGS = stress.Settings(5, ["good", "tight"], [0.0, 0.1, 0.25], 3, 1, THRESHOLDS)
GOOD = {s.number: 0.01 * np.eye(2) for s in SUBMAPS}
METHODS = {"good": GOOD, "tight": {n: 1e-4 * q for n, q in GOOD.items()}}
COVERAGES = loop_gate.coverages([s.points for s in SUBMAPS], GRAPH.truth, GRAPH_SETTINGS.cell_factor * SPACING)
EXPERIMENT = stress.Experiment(GRAPH, METHODS, false_closures.pairs_apart(COVERAGES), 0.03, SETTINGS)
PARAMS = Path(__file__).parents[2] / "params.yaml"
ERRORS = ["rmse_xyz_m", "truth_rmse_xyz_m", "truth_relative_m"]


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    return stress.benchmark(EXPERIMENT)


def select(rows: pd.DataFrame, **values: object) -> pd.DataFrame:
    """Return the rows whose columns have these values."""
    for name, value in values.items():
        rows = rows[rows[name] == value]
    return rows


def test_without_false_closures_and_kernel_it_is_the_plain_optimiser(rows: pd.DataFrame):
    closures = GRAPH.draws[1]
    covariances = pose_graph.closure_covariances(
        np.tile(0.01 * np.eye(2), (len(closures.registration), 1, 1)), GRAPH.closure_noise
    )
    dead_reckoning = stress.corrupt(EXPERIMENT, 1)
    initial = pose_graph.chain(GRAPH.gt[0], dead_reckoning)
    plain = PoseGraph(GRAPH.gt[0], closures.edges, covariances).optimise(
        dead_reckoning, GRAPH.dead_reckoning_noise, initial
    )
    expected = np.sqrt(np.mean(np.sum((plain - GRAPH.truth)[:, :3, 3] ** 2, axis=1)))
    row = select(rows, kernel="plain", share=0.0, method="good", repetition=1)
    assert row["draw"].tolist() == [1]
    assert row["truth_rmse_xyz_m"].tolist() == pytest.approx([expected], rel=1e-3)


def test_gnc_stands_a_quarter_of_false_closures_that_ruin_the_plain_optimiser(rows: pd.DataFrame):
    none = select(rows, kernel="plain", share=0.25, method="good")["truth_rmse_xyz_m"].median()
    gnc = select(rows, kernel="gnc", start="cauchy", share=0.25, method="good")
    assert gnc["truth_rmse_xyz_m"].median() < 0.3 * none
    assert gnc["accepted_false"].sum() == 0
    assert gnc["accepted_true"].sum() > 0.8 * gnc["true_closures"].sum()


def test_the_right_covariance_keeps_more_true_closures_than_one_that_is_too_small(rows: pd.DataFrame):
    kept = [
        select(rows, kernel="dcs", start="cauchy", method=name)["accepted_true"].sum() for name in ("good", "tight")
    ]
    assert kept[0] > kept[1]


def test_every_kernel_but_the_first_starts_where_that_ended_and_a_few_from_the_corrupted_poses_too(rows: pd.DataFrame):
    counts = select(rows, share=0.1, method="good").groupby(["kernel", "start"]).size().to_dict()
    first = {("plain", "corrupted"): 3, ("cauchy", "corrupted"): 3}
    assert counts == first | {(k, s): n for k in ("huber", "dcs", "gnc") for s, n in (("cauchy", 3), ("corrupted", 1))}


def test_false_closures_never_join_submaps_that_overlap():
    assert len(EXPERIMENT.pairs_apart)
    for repetition in range(3):
        true = len(GRAPH.draws[repetition % 2].edges.source)
        _, edges = stress.with_false(EXPERIMENT, repetition)[-1]
        k, i = edges.target[true:], edges.source[true:]
        assert (i > k + 1).all()
        assert (COVERAGES[i, k] == 0).all()


def test_false_closures_have_the_x_y_of_a_true_one_and_the_rest_of_gt():
    true = GRAPH.draws[0].edges
    _, edges = stress.with_false(EXPERIMENT, 0)[-1]
    false = edges.T_target_source[len(true.source) :]
    gt = np.linalg.inv(GRAPH.gt[edges.target]) @ GRAPH.gt[edges.source]
    assert {tuple(xy) for xy in false[:, :2, 3]} <= {tuple(xy) for xy in true.T_target_source[:, :2, 3]}
    expected = gt[len(true.source) :]
    assert false[:, :, :3] == pytest.approx(expected[:, :, :3])
    assert false[:, 2, 3] == pytest.approx(expected[:, 2, 3])


def test_a_share_is_of_all_closures_and_a_lower_one_is_among_the_higher():
    true = len(GRAPH.draws[0].edges.source)
    by_share = dict(stress.with_false(EXPERIMENT, 0))
    for share, edges in by_share.items():
        assert (len(edges.source) - true) / len(edges.source) == pytest.approx(share, abs=0.02)
    few, many = (by_share[share].T_target_source for share in (0.1, 0.25))
    assert (many[: len(few)] == few).all()
    assert false_closures.counts(90, [0.0, 0.1, 0.5]) == [0, 10, 90]


def test_each_repetition_has_its_own_false_closures_and_noise_and_each_run_the_same():
    first, again, other = (stress.with_false(EXPERIMENT, r)[-1][1] for r in (0, 0, 2))
    assert (first.T_target_source == again.T_target_source).all()
    assert not np.array_equal(first.target, other.target)
    assert not np.allclose(stress.corrupt(EXPERIMENT, 0), stress.corrupt(EXPERIMENT, 1))


def test_the_table_does_not_depend_on_the_number_of_workers(
    rows: pd.DataFrame, monkeypatch: pytest.MonkeyPatch, tmp_path: pytest.TempPathFactory
):
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    alone = stress.benchmark(EXPERIMENT)
    monkeypatch.setenv("POINTNETKL_WORKERS", "3")
    together = stress.benchmark(EXPERIMENT)
    for name, table in (("one", alone), ("three", together)):
        artifacts.write_table(tmp_path / name, table, robust_schemas.ROWS, {})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "three").read_bytes()


def test_a_run_that_fails_is_a_row_of_nulls_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch, tmp_path):
    solve: Callable = estimators.RobustGraph.solve

    def fail(
        self: estimators.RobustGraph, kernel: str, start: estimators.Solution | None = None
    ) -> estimators.Solution:
        if kernel == "gnc":
            raise estimators.RobustError("indeterminate")
        return solve(self, kernel, start)

    monkeypatch.setattr(estimators.RobustGraph, "solve", fail)
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    rows = stress.benchmark(dataclasses.replace(EXPERIMENT, settings=dataclasses.replace(SETTINGS, repetitions=1)))
    assert rows["failed"].tolist() == (rows["kernel"] == "gnc").tolist()
    assert select(rows, kernel="gnc")[[*ERRORS, "accepted_true"]].isna().all(axis=None)
    assert select(rows, failed=False)[ERRORS].notna().all(axis=None)
    artifacts.write_table(tmp_path / "rows", rows, robust_schemas.ROWS, {})
    assert artifacts.read_table(tmp_path / "rows", robust_schemas.ROWS)["failed"].any()


def test_a_survey_without_truth_or_closures_still_has_rows_of_share_0():
    submaps, line = graph(1, 3, has_truth=False)
    methods = {"good": {s.number: 0.01 * np.eye(2) for s in submaps}}
    rows = stress.benchmark(stress.Experiment(line, methods, EXPERIMENT.pairs_apart[:0], 0.03, SETTINGS))
    assert set(rows["share"]) == {0.0}
    assert rows["truth_rmse_xyz_m"].isna().all()
    assert (rows["accepted_true"] == 0).all()
    assert not rows["failed"].any()


def test_a_method_that_nobody_estimated_is_named():
    with pytest.raises(stress.StressError, match=r"stress\.methods names tight, .* there are good"):
        stress.select_methods({"good": GOOD}, SETTINGS, "toy")


def test_the_noise_is_not_that_of_the_benchmark_of_covariances():
    slam, settings = (
        parameters.read(PARAMS, "slam", protocol.Settings),
        parameters.read(PARAMS, "stress", stress.Settings),
    )
    experiment = dataclasses.replace(EXPERIMENT, yaw_sigma_rad=slam.yaw_sigma_rad, settings=settings)
    of_slam = [protocol.corrupt(GRAPH, draw, repetition, slam) for draw in range(10) for repetition in range(10)]
    for repetition in range(10):
        noisy = stress.corrupt(experiment, repetition)
        assert np.abs(noisy - pose_graph.between(GRAPH.gt)).max() > 1e-3
        assert not any(np.allclose(noisy, other, atol=1e-6) for other in of_slam)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seed", -1),
        ("methods", []),
        ("methods", ["good", "good"]),
        ("shares", [0.0, 1.0]),
        ("shares", [0.0, 0.999999]),
        ("shares", [0.5, 0.1]),
        ("shares", []),
        ("repetitions", 0),
        ("corrupted_repetitions", -1),
    ],
)
def test_settings_that_make_no_sense_are_refused(name: str, value: object):
    with pytest.raises(ValueError, match=f"^{name} is"):
        dataclasses.replace(SETTINGS, **{name: value})
