"""The benchmark: the same corruption for every method, and what its rows say."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from pointnetkl.slam.benchmark import benchmark as slam_benchmark
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.benchmark import schemas as slam_schemas
from pointnetkl.slam.graph import pose_graph, survey_graph, trajectory_error
from toy_survey import REGISTRATION, graph

SETTINGS = protocol.Settings(3, 4, 2, 0.05, "all", 0.0, 2, 15.0, 2)
SUBMAPS, GRAPH = graph(4, 4, apart=6.0)
GOOD = {s.number: 0.01 * np.eye(2) for s in SUBMAPS}
METHODS = {"network": GOOD, "again": GOOD, "useless": {n: 1e8 * q for n, q in GOOD.items()}}


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in this process: on so small a graph others take longer to start."""
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")


def benchmark(
    survey_graph_: survey_graph.SurveyGraph = GRAPH,
    settings: protocol.Settings = SETTINGS,
    methods: protocol.Methods = METHODS,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return rows and trajectories, with a map error of 1 m."""
    return slam_benchmark.benchmark(survey_graph_, methods, {"map_to_map_m": lambda poses: 1.0}, settings)


def errors(rows: pd.DataFrame, method: str, column: str = "rmse_xyz_m", variant: str = "table") -> np.ndarray:
    """Return a method's column on the first draw, by repetition."""
    selected = (rows["method"] == method) & (rows["variant"] == variant) & (rows["draw"] == 0)
    return rows[selected].sort_values("repetition")[column].to_numpy()


def test_every_method_gets_the_same_noise():
    rows, _ = benchmark()
    assert (errors(rows, "network") == errors(rows, "again")).all()


def test_closures_correct_by_their_yaw_even_where_x_and_y_say_nothing():
    # as in the paper, a closure's yaw is that of GT: what Q can add is the rest
    rows, _ = benchmark()
    good, useless, corrupted = (errors(rows, name).mean() for name in ("network", "useless", "corrupted"))
    assert good < useless < corrupted


def test_with_yaw_a_covariance_that_knows_nothing_corrects_nothing():
    # the same closures, of which one method is sure, and the other not even of yaw
    submaps, survey_graph_ = graph(4, 4, apart=6.0, registration=dataclasses.replace(REGISTRATION, dof="xyyaw"))
    sure = {s.number: np.diag([0.01, 0.01, 1e-5]) for s in submaps}
    methods = {"network": sure, "useless": {n: 1e8 * q for n, q in sure.items()}}
    rows, _ = benchmark(survey_graph_, methods=methods)
    good, useless, corrupted = (errors(rows, name).mean() for name in ("network", "useless", "corrupted"))
    assert good < 0.6 * corrupted
    assert useless == pytest.approx(corrupted, rel=0.01)


def test_loop_closures_with_their_covariances_undo_most_of_the_corruption():
    rows, _ = benchmark()
    assert errors(rows, "network").mean() < 0.6 * errors(rows, "corrupted").mean()


def test_without_noise_the_estimate_is_gt_as_far_as_the_closures_allow():
    rows, _ = benchmark(settings=dataclasses.replace(SETTINGS, yaw_sigma_rad=0.0))
    assert errors(rows, "corrupted") == pytest.approx(0.0, abs=1e-9)
    assert errors(rows, "network").max() < 0.3


def test_navigation_has_one_row_and_is_its_distance_from_gt():
    rows, _ = benchmark()
    expected = trajectory_error.rmse(GRAPH.navigation[:, :3, 3], GRAPH.gt[:, :3, 3])
    assert errors(rows, "navigation") == pytest.approx([expected])


def test_map_to_map_is_measured_in_the_first_repetitions_only():
    rows, _ = benchmark()
    assert np.isfinite(errors(rows, "network", "map_to_map_m")).tolist() == [True, True, False, False]


def test_the_freer_the_alignment_the_smaller_the_error():
    rows, _ = benchmark()
    for against in ("", "truth_"):
        free, plane, none = (rows[f"{against}rmse_{alignment}_m"] for alignment in ("4dof", "se2", "xyz"))
        assert (free <= plane + 1e-9).all()
        assert (plane <= none + 1e-9).all()


def test_trajectories_of_the_first_repetition_are_kept():
    _, trajectories = benchmark()
    assert trajectories["which"].unique().tolist() == ["truth", "gt", "navigation", "corrupted", *METHODS]
    assert (trajectories.groupby("which").size() == len(SUBMAPS)).all()
    assert list(trajectories.columns) == slam_schemas.TRAJECTORIES.names


def test_a_survey_without_truth_or_closures_still_has_rows():
    _, line = graph(1, 3, has_truth=False)
    rows, trajectories = benchmark(line)
    assert rows["truth_rmse_xyz_m"].isna().all()
    assert errors(rows, "network") == pytest.approx(errors(rows, "corrupted"), abs=1e-6)
    assert "truth" not in set(trajectories["which"])
    assert list(rows.columns) == slam_schemas.ROWS.names


def test_shared_edges_are_trusted_less():
    assert len(GRAPH.closures.edges.source) > len(GRAPH.closures.node)  # some registrations have several edges
    rows, _ = benchmark()
    swapped, _ = benchmark(settings=dataclasses.replace(SETTINGS, edges="shared"))
    shared = errors(rows, "network", variant="shared")
    assert (shared != errors(rows, "network")[:2]).all()
    assert (shared == errors(swapped, "network")[:2]).all()
    assert (errors(swapped, "network", variant="all") == errors(rows, "network")[:2]).all()
    assert (errors(swapped, "corrupted") == errors(rows, "corrupted")).all()


def test_every_draw_has_rows_of_its_own_closures_and_noise():
    rows, _ = benchmark()
    network = rows[(rows["method"] == "network") & (rows["variant"] == "table")]
    assert network.groupby("draw").size().tolist() == [4, 2]
    assert network["rmse_xyz_m"].nunique() == 6
    noise = rows[rows["method"] == "corrupted"]
    assert noise["rmse_xyz_m"].nunique() == len(noise) == 6


def test_a_draw_s_first_noises_are_the_same_however_many_follow():
    many, _ = benchmark()
    few, _ = benchmark(settings=dataclasses.replace(SETTINGS, repetitions=2))
    assert (errors(few, "network") == errors(many, "network")[:2]).all()


def test_rows_do_not_depend_on_the_number_of_workers(monkeypatch: pytest.MonkeyPatch):
    settings = dataclasses.replace(SETTINGS, repetitions=12)  # more than a worker takes at once
    alone, _ = benchmark(settings=settings)
    monkeypatch.setenv("POINTNETKL_WORKERS", "3")
    together, _ = benchmark(settings=settings)
    pd.testing.assert_frame_equal(alone, together, check_exact=True)


def test_what_cannot_be_solved_has_no_number_and_is_told(monkeypatch: pytest.MonkeyPatch):
    solve = pose_graph.PoseGraph.solve
    solved = iter([True] * 5 + [False] + [True] * 100)

    def sometimes(self: pose_graph.PoseGraph, odometry: pose_graph.Odometry) -> np.ndarray:
        if next(solved):
            return solve(self, odometry)
        raise pose_graph.PoseGraphError("no")

    monkeypatch.setattr(pose_graph.PoseGraph, "solve", sometimes)
    rows, trajectories = benchmark()
    assert rows["rmse_xyz_m"].isna().sum() == 1
    assert np.isfinite(trajectories["x_m"]).all()
    (sentence,) = slam_benchmark.unsolved(rows)
    assert "1 of " in sentence


def test_a_solution_claims_its_position_once_a_method():
    rows, _ = benchmark()
    claimed = rows[rows["pose_nees"].notna()]
    assert sorted(claimed["method"]) == sorted(METHODS)
    assert (claimed[["draw", "repetition"]] == 0).all().all()
