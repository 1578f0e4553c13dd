"""The benchmark: the same corruption for every method, and what its rows say."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from pointnetkl import metrics, pose_graph, slam, survey_graph
from pointnetkl.covariance import gaussian, table
from toy_survey import REGISTRATION, graph

SETTINGS = slam.Settings(3, 4, 0.05, "all", 2, 15.0, 2)
SUBMAPS, GRAPH = graph(4, 4, apart=6.0)
GOOD = {s.number: 0.01 * np.eye(2) for s in SUBMAPS}
METHODS = {"good": GOOD, "again": GOOD, "useless": {n: 1e8 * q for n, q in GOOD.items()}}


def benchmark(made: survey_graph.SurveyGraph = GRAPH, settings: slam.Settings = SETTINGS):
    return slam.benchmark(made, METHODS, lambda poses: 1.0, settings)


def errors(rows: pd.DataFrame, method: str, column: str = "rmse_xyz_m") -> np.ndarray:
    return rows[rows["method"] == method].sort_values("repetition")[column].to_numpy()


def test_every_method_gets_the_same_noise():
    rows, _ = benchmark()
    assert (errors(rows, "good") == errors(rows, "again")).all()


def test_closures_correct_by_their_yaw_even_where_x_and_y_say_nothing():
    # as in the paper, a closure's yaw is that of GT: what Q can add is the rest
    rows, _ = benchmark()
    good, useless, corrupted = (errors(rows, name).mean() for name in ("good", "useless", "corrupted"))
    assert good < useless < corrupted


def test_with_yaw_a_covariance_that_knows_nothing_corrects_nothing():
    # the same closures, of which one method is sure, and the other not even of yaw
    submaps, made = graph(4, 4, apart=6.0, registration=dataclasses.replace(REGISTRATION, dof="xyyaw"))
    sure = {s.number: np.diag([0.01, 0.01, 1e-5]) for s in submaps}
    methods = {"good": sure, "useless": {n: 1e8 * q for n, q in sure.items()}}
    rows, _ = slam.benchmark(made, methods, lambda poses: 1.0, SETTINGS)
    good, useless, corrupted = (errors(rows, name).mean() for name in ("good", "useless", "corrupted"))
    assert good < 0.6 * corrupted
    assert useless == pytest.approx(corrupted, rel=0.01)


def test_noise_is_new_in_each_repetition_and_the_same_in_each_run():
    first, second = slam.corrupt(GRAPH, 0, SETTINGS), slam.corrupt(GRAPH, 1, SETTINGS)
    assert (first == slam.corrupt(GRAPH, 0, SETTINGS)).all()
    assert not np.allclose(first, second)
    assert not np.allclose(first, slam.corrupt(dataclasses.replace(GRAPH, survey="other"), 0, SETTINGS))


def test_only_the_yaw_of_dead_reckoning_is_corrupted():
    exact, noisy = pose_graph.between(GRAPH.gt), slam.corrupt(GRAPH, 0, SETTINGS)
    assert noisy[:, :3, 3] == pytest.approx(exact[:, :3, 3])
    turn = np.linalg.inv(exact) @ noisy
    assert turn[:, 2, :3] == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(turn), 1)), abs=1e-9)
    assert 0.5 < np.arctan2(turn[:, 1, 0], turn[:, 0, 0]).std() / SETTINGS.yaw_sigma_rad < 2


def test_loop_closures_with_their_covariances_undo_most_of_the_corruption():
    rows, _ = benchmark()
    assert errors(rows, "good").mean() < 0.6 * errors(rows, "corrupted").mean()


def test_without_noise_the_estimate_is_gt_as_far_as_the_closures_allow():
    rows, _ = benchmark(settings=dataclasses.replace(SETTINGS, yaw_sigma_rad=0.0))
    assert errors(rows, "corrupted") == pytest.approx(0.0, abs=1e-9)
    assert errors(rows, "good").max() < 0.3


def test_navigation_has_one_row_and_is_its_distance_from_gt():
    rows, _ = benchmark()
    assert errors(rows, "navigation") == pytest.approx([metrics.rmse(GRAPH.navigation[:, :3, 3], GRAPH.gt[:, :3, 3])])


def test_map_to_map_is_measured_in_the_first_repetitions_only():
    rows, _ = benchmark()
    assert np.isfinite(errors(rows, "good", "map_to_map_m")).tolist() == [True, True, False, False]


def test_alignment_in_the_plane_never_raises_the_error():
    rows, _ = benchmark()
    assert (rows["rmse_se2_m"] <= rows["rmse_xyz_m"] + 1e-9).all()


def test_trajectories_of_the_first_repetition_are_kept():
    _, trajectories = benchmark()
    assert trajectories["which"].unique().tolist() == ["truth", "gt", "navigation", "corrupted", *METHODS]
    assert (trajectories.groupby("which").size() == len(SUBMAPS)).all()
    assert list(trajectories.columns) == slam.TRAJECTORIES.names


def test_a_survey_without_truth_or_closures_still_has_rows():
    _, line = graph(1, 3, known=False)
    rows, trajectories = benchmark(line)
    assert rows["truth_rmse_xyz_m"].isna().all()
    assert errors(rows, "good") == pytest.approx(errors(rows, "corrupted"), abs=1e-6)
    assert "truth" not in set(trajectories["which"])
    assert list(rows.columns) == slam.ROWS.names


def test_a_registration_shared_by_its_edges_counts_once():
    registration = np.array([0, 1, 1, 2, 2, 2])
    assert slam.weights(registration, "all").tolist() == [1] * 6
    assert slam.weights(registration, "shared").tolist() == [1, 2, 2, 3, 3, 3]
    # the information of its edges then adds up to that of one Q
    assert np.bincount(registration, 1 / slam.weights(registration, "shared")).tolist() == pytest.approx([1, 1, 1])
    assert slam.weights(registration[:0], "shared").shape == (0,)


def test_shared_edges_are_trusted_less():
    assert len(GRAPH.closures.edges.source) > len(GRAPH.closures.node)  # some registrations have several edges
    all_rows, _ = benchmark()
    shared, _ = benchmark(settings=dataclasses.replace(SETTINGS, edges="shared"))
    assert (errors(shared, "good") != errors(all_rows, "good")).all()
    assert (errors(shared, "corrupted") == errors(all_rows, "corrupted")).all()


@pytest.mark.parametrize("bad", [[[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]]])
def test_what_is_not_a_covariance_never_reaches_the_optimiser(bad: list[list[float]]):
    rows = table.from_matrices("toy", "m", [0, 1], np.array([np.eye(2), np.eye(2)]))
    rows.loc[1, ["q_xx_m2", "q_xy_m2", "q_yy_m2"]] = [bad[0][0], bad[0][1], bad[1][1]]
    with pytest.raises(gaussian.CovarianceError, match="submap 1, m"):
        slam.by_method(rows)


def test_two_covariances_of_one_name_for_one_submap_are_refused():
    rows = table.from_matrices("toy", "m", [0], np.eye(2)[None])
    with pytest.raises(slam.SlamError, match="two covariances for submap 0"):
        slam.by_method(pd.concat([rows, rows]))


def test_clouds_follow_the_nodes_and_a_missing_one_is_named():
    clouds = {s.number: s.points for s in SUBMAPS}
    assert slam.clouds_of(GRAPH, clouds)[5] is SUBMAPS[5].points
    del clouds[5]
    with pytest.raises(slam.SlamError, match="submap 5"):
        slam.clouds_of(GRAPH, clouds)


def test_an_unknown_way_to_count_edges_is_refused():
    with pytest.raises(slam.SlamError, match="all or shared"):
        dataclasses.replace(SETTINGS, edges="some")
