"""Loop closures: which submaps close one, what their edges measure, and how well."""

import dataclasses
import itertools

import numpy as np
import pandas as pd
import pytest

from pointnetkl.registration import gicp, pair
from pointnetkl.slam.closures import graph_construction, loop_closure, reference
from pointnetkl.slam.graph import footprint, survey_graph
from pointnetkl.slam.graph.survey_graph import Closures
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2
from toy_survey import REGISTRATION, SETTINGS, SPACING, graph, sail

WITH_YAW = dataclasses.replace(REGISTRATION, dof="xyyaw")
BY_MAP = dataclasses.replace(SETTINGS, method="map")
SUBMAPS = pd.DataFrame({"time_s": [1.0], "yaw_rad": [np.pi]})
HEADING = pd.DataFrame({"time_s": [0.0, 2.0], "yaw_rad": [3.1, -3.1]})
TRAJECTORY = pd.DataFrame({"time_s": [0.0, 2.0], "x_m": [0.0, 4.0], "y_m": 1.0, "z_m": -5.0, "yaw_rad": [3.1, -3.1]})

SQUARE = np.stack(np.meshgrid(np.arange(0.5, 10), np.arange(0.5, 10)), -1).reshape(-1, 2)


def close(lines: int, along: int, apart: float = 10.0) -> tuple[Closures, np.ndarray]:
    submaps, truth = sail(lines, along, apart)
    starts = loop_closure.starts("toy", submaps, SETTINGS)
    return loop_closure.close(submaps, truth, starts, SPACING, SETTINGS, REGISTRATION), truth


def test_coverage_is_the_share_of_cells_in_common():
    a, b = footprint.cells(SQUARE, 1.0), footprint.cells(SQUARE + np.array([4.0, 0.0]), 1.0)
    assert footprint.coverage(a, a) == 1.0
    assert footprint.coverage(a, b) == pytest.approx(0.6)


def test_a_small_footprint_inside_a_large_one_is_covered_but_does_not_cover():
    small, large = footprint.cells(SQUARE[:20], 1.0), footprint.cells(SQUARE, 1.0)
    assert footprint.coverage(small, large) == 1.0
    assert footprint.coverage(large, small) == pytest.approx(0.2)


def test_cells_are_told_apart_on_either_side_of_the_origin():
    corners = np.array([[0.5, 0.5], [-0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
    assert len(footprint.cells(corners, 1.0)) == 4


def test_a_loop_needs_the_asked_coverage():
    footprints = footprint.Footprints(1.0)
    footprints.add(SQUARE)
    assert footprints.covering(SQUARE + np.array([4.0, 0.0]), 0.6, among=1).tolist() == [0]
    assert footprints.covering(SQUARE + np.array([5.0, 0.0]), 0.6, among=1).tolist() == []
    assert footprints.covering(SQUARE, 0.6, among=0).tolist() == []


def test_the_submap_just_before_never_closes_a_loop():
    # each submap lies over all the ones before it
    submaps, truth = sail(1, 1)
    pile = [dataclasses.replace(submaps[0], number=k) for k in range(3)]
    starts = np.zeros((3, 2))
    closures = loop_closure.close(pile, truth.repeat(3, axis=0), starts, SPACING, SETTINGS, REGISTRATION)
    assert [closures.edges.target.tolist(), closures.edges.source.tolist()] == [[0], [2]]


def test_lines_too_far_apart_close_no_loops_and_a_single_line_closes_none():
    assert len(close(2, 3, apart=30.0)[0].node) == 0
    closures, truth = close(1, 3)
    assert survey_graph.errors(closures, truth).shape == (0, 2)
    assert survey_graph.registration_errors(closures, truth).shape == (0, 2)


def test_a_loop_closure_measures_the_relative_pose_of_its_submaps():
    closures, truth = close(3, 4)
    assert len(closures.node) >= 6
    edges = closures.edges
    assert np.abs(survey_graph.errors(closures, truth)).max() < 0.2
    exact = np.linalg.inv(truth[edges.target]) @ truth[edges.source]
    # z, roll, pitch and yaw are those of the poses handed in
    assert edges.T_target_source[:, :3, :3] == pytest.approx(exact[:, :3, :3])
    assert edges.T_target_source[:, 2, 3] == pytest.approx(exact[:, 2, 3])


def test_every_registration_starts_elsewhere_by_a_draw_of_the_prior():
    submaps, _ = sail(3, 100 // 3)
    draws = loop_closure.starts("toy", submaps, dataclasses.replace(SETTINGS, prior_variance_m2=9.0))
    assert draws.std() == pytest.approx(3.0, rel=0.2)
    # a submap's own draw, whatever the others are
    assert (
        loop_closure.starts("toy", submaps[7:9], SETTINGS) == loop_closure.starts("toy", submaps, SETTINGS)[7:9]
    ).all()


def test_a_corrected_submap_replaces_the_one_that_was_handed_in():
    submaps, truth = sail(3, 1)
    stack, poses = [submaps[0]] * 5, truth[[0, 0, 0, 0, 0]].copy()
    poses[2, :2, 3] += [1.0, 0.5]  # navigation errs here, and only here
    closures = loop_closure.close(stack, poses, np.zeros((5, 2)), SPACING, SETTINGS, REGISTRATION)
    assert closures.correction[0] == pytest.approx([-1.0, -0.5], abs=1e-2)
    assert closures.edges.T_target_source[:, :2, 3] == pytest.approx(
        np.zeros((len(closures.edges.source), 2)), abs=2e-2
    )


def test_with_yaw_a_loop_closure_measures_that_too():
    submaps, truth = sail(3, 4)
    starts = loop_closure.starts("toy", submaps, SETTINGS, 3)
    closures = loop_closure.close(submaps, truth, starts, SPACING, SETTINGS, WITH_YAW)
    e = survey_graph.errors(closures, truth)
    assert e.shape == (len(closures.edges.source), 3)
    assert np.abs(e).max(axis=0) == pytest.approx(np.zeros(3), abs=0.2)
    assert 0 < np.abs(e[:, 2]).max() < 0.01
    assert np.abs(starts[closures.node] - closures.start[:, :3]).max(axis=0)[2] == 0
    assert starts[:, :2] == pytest.approx(loop_closure.starts("toy", submaps, SETTINGS))


def test_a_submap_that_navigation_turned_is_turned_back_about_its_own_middle():
    submaps, truth = sail(3, 1)
    stack, poses = [submaps[0]] * 5, truth[[0, 0, 0, 0, 0]].copy()
    poses[2] = truth[0] @ pose.matrix(np.array([1.0, 0.5, 0.0]), 0.05)  # navigation errs here, and only here
    closures = loop_closure.close(stack, poses, np.zeros((5, 3)), SPACING, SETTINGS, WITH_YAW)
    assert closures.correction[0] == pytest.approx([-1.0, -0.5, -0.05], abs=1e-2)
    exact = np.tile(np.eye(4), (len(closures.edges.source), 1, 1))
    assert closures.edges.T_target_source == pytest.approx(exact, abs=2e-2)


def test_errors_with_yaw_are_about_the_middle_of_the_source_s_points():
    submaps, truth = sail(2, 3)
    away = [dataclasses.replace(s, points=s.points + np.array([30.0, 20.0, 0.0])) for s in submaps]
    poses = truth @ pose.matrix(np.array([-30.0, -20.0, 0.0]), 0.0)  # the same ground, from frames elsewhere
    ours, theirs = (
        survey_graph.errors(loop_closure.close(s, T, np.zeros((6, 3)), SPACING, SETTINGS, WITH_YAW), T)
        for s, T in ((submaps, truth), (away, poses))
    )
    assert theirs == pytest.approx(ours, abs=1e-3)


def test_drift_in_yaw_is_carried_on_to_where_the_next_submap_is():
    submaps, truth = sail(2, 3, apart=4.0)
    navigation = pose.matrix(np.array([0.5, -0.3, 0.0]), 0.02) @ truth
    navigation[:3] = truth[:3]  # the first line is right, all of the second is off by one motion
    closures = loop_closure.close(submaps, navigation, None, SPACING, SETTINGS, WITH_YAW)
    assert closures.node.tolist() == [4, 5]
    first, second = np.abs(closures.start - closures.correction).max(axis=1)
    assert second < 0.2 < 0.5 < first
    assert np.abs(survey_graph.errors(closures, truth)).max(axis=0) == pytest.approx([0, 0, 0], abs=0.2)


def test_a_graph_with_yaw_comes_back_from_its_file_and_refuses_covariances_without():
    _, survey_graph_ = graph(4, 4, registration=WITH_YAW)
    arrays = survey_graph.to_arrays(survey_graph_)
    again = survey_graph.to_arrays(survey_graph.from_arrays(arrays))
    assert {k: v.tobytes() for k, v in again.items()} == {k: v.tobytes() for k, v in arrays.items()}
    assert arrays["registration_error_truth_m"].shape == (sum(len(draw.node) for draw in survey_graph_.draws), 3)
    assert (
        survey_graph.summary(survey_graph_)["gt_truth_rmse_xyz_m"]
        < survey_graph.summary(survey_graph_)["navigation_truth_rmse_xyz_m"]
    )
    with pytest.raises(survey_graph.SurveyGraphError, match="registrations have 3 dimensions"):
        survey_graph.edge_covariances(
            survey_graph_.number, {int(n): np.eye(2) for n in survey_graph_.number}, survey_graph_.closures, "toy"
        )


def test_flat_ground_does_not_pull_a_half_covered_submap_across_its_target():
    submaps, truth = sail(2, 3)
    flat = [dataclasses.replace(s, points=s.points * [1, 1, 0] - [0, 0, 40]) for s in submaps]
    starts, errors = np.zeros((6, 2)), []
    for factor in (2.0, None):
        settings = dataclasses.replace(SETTINGS, overlap_factor=factor)
        closures = loop_closure.close(flat, truth, starts, SPACING, settings, REGISTRATION)
        errors.append(np.abs(survey_graph.errors(closures, truth)).max())
    assert errors[0] < 2.0 < 5.0 < errors[1]


@pytest.mark.parametrize("registration", [REGISTRATION, WITH_YAW])
def test_map_finds_the_relative_poses_too(registration: gicp.Settings):
    submaps, truth = sail(3, 4)
    starts = loop_closure.starts("toy", submaps, SETTINGS, registration.dimensions)
    by_map = loop_closure.close(submaps, truth, starts, SPACING, BY_MAP, registration)
    by_gicp = loop_closure.close(submaps, truth, starts, SPACING, SETTINGS, registration)
    assert by_map.node.tolist() == by_gicp.node.tolist()
    errors = np.abs(survey_graph.errors(by_map, truth)).max(axis=0)
    assert errors[:2].max() < 0.2
    assert (errors[2:] < 0.01).all()
    assert not np.array_equal(by_map.correction, by_gicp.correction)


def test_with_yaw_the_prior_of_a_part_is_that_of_the_start_at_its_own_middle():
    submaps, truth = sail(1, 1)
    target = cloud = pose.transform(truth[0], submaps[0].points)
    part = cloud[cloud[:, 0] > np.median(cloud[:, 0])]
    settings = pair.Settings.of(WITH_YAW, "map")
    sigmas = np.array([1.0, 1.0, 0.05])
    origin, lever = cloud.mean(axis=0), (part - cloud.mean(axis=0)).mean(axis=0)[:2]
    search = loop_closure.MapSearch(np.diag(sigmas**2), SPACING, settings)
    start = SE2(np.array([0.4, -0.3]), 0.02)
    found = loop_closure.Ground(target, origin, None, WITH_YAW, search).register(part, start)
    J = np.eye(3)
    J[:2, 2] = -lever[1], lever[0]  # how a turn about the cloud's middle moves the part's
    source, to = gicp.prepare(part - origin, WITH_YAW), gicp.prepare(target - origin, WITH_YAW)
    about_target = start.from_centre(-to.centre[:2])
    expected = pair.register(source, to, J @ search.prior @ J.T, SPACING, settings, about_target)
    assert found is not None
    moved = found[0].from_centre(-(origin + to.centre)[:2])
    assert moved.to_vector() == pytest.approx(expected.T_target_source.to_vector(), abs=1e-9)


def test_by_map_flat_ground_leaves_a_submap_nearer_to_its_start_than_by_gicp():
    submaps, truth = sail(2, 3)
    flat = [dataclasses.replace(s, points=s.points * [1, 1, 0] - [0, 0, 40]) for s in submaps]
    starts = loop_closure.starts("toy", submaps, SETTINGS)
    moved = []
    for settings in (BY_MAP, SETTINGS):
        closures = loop_closure.close(flat, truth, starts, SPACING, settings, REGISTRATION)
        moved.append(np.abs(closures.correction - closures.start[:, :2]).max())
    assert moved[0] < 1e-3 < 1e-1 < moved[1]


def test_errors_are_in_the_source_frame():
    closures, truth = close(2, 3)
    missed = truth.copy()
    missed[:, :2, 3] += np.eye(2)[0] * (np.arange(6) >= 3)[:, None]  # the whole second line, by 1 m east
    change = survey_graph.errors(closures, missed) - survey_graph.errors(closures, truth)
    # that line heads west, so east is minus its x
    assert change == pytest.approx(np.tile([-1.0, 0.0], (len(change), 1)), abs=1e-9)


def test_gt_is_closer_to_the_truth_than_navigation():
    _, survey_graph_ = graph(4, 4)
    figures = survey_graph.summary(survey_graph_)
    assert figures["gt_truth_rmse_xyz_m"] < 0.7 * figures["navigation_truth_rmse_xyz_m"]


def test_a_graph_comes_back_from_its_file_and_is_made_the_same_twice():
    arrays = survey_graph.to_arrays(graph()[1])
    for again in (survey_graph.to_arrays(survey_graph.from_arrays(arrays)), survey_graph.to_arrays(graph()[1])):
        assert {k: v.tobytes() for k, v in again.items()} == {k: v.tobytes() for k, v in arrays.items()}


def test_a_graph_without_truth_has_errors_that_are_not_numbers():
    arrays = survey_graph.to_arrays(graph(has_truth=False)[1])
    assert np.isnan(arrays["registration_error_truth_m"]).all()
    assert np.isfinite(arrays["registration_error_gt_m"]).all()
    assert survey_graph.summary(survey_graph.from_arrays(arrays))["gt_truth_rmse_xyz_m"] is None


def test_truth_is_interpolated_through_the_turn_of_the_compass():
    T = graph_construction.true_poses(SUBMAPS, HEADING, TRAJECTORY)[0]
    assert T[:3, 3] == pytest.approx([2.0, 1.0, -5.0])
    assert abs(np.arctan2(T[1, 0], T[0, 0])) == pytest.approx(np.pi)


def test_a_submap_is_turned_by_the_error_of_the_heading_and_not_onto_the_heading():
    crabbing = SUBMAPS.assign(yaw_rad=3.0)  # its track; the vehicle points elsewhere
    wrong = HEADING.assign(yaw_rad=HEADING["yaw_rad"] + 0.05)
    T = graph_construction.true_poses(crabbing, wrong, TRAJECTORY)[0]
    assert np.arctan2(T[1, 0], T[0, 0]) == pytest.approx(2.95)


def test_a_truth_that_does_not_reach_a_submap_is_refused():
    late = SUBMAPS.assign(time_s=3.0)
    with pytest.raises(graph_construction.GraphConstructionError, match="submap is at 3"):
        graph_construction.true_poses(late, HEADING, TRAJECTORY)
    assert np.isnan(graph_construction.true_poses(SUBMAPS, HEADING, TRAJECTORY[:0])).all()


def test_draws_start_elsewhere_and_the_first_does_not_depend_on_how_many_there_are():
    submaps, truth = sail(2, 3)
    q = {s.number: 0.01 * np.eye(2) for s in submaps}
    single, three = (
        graph_construction.build(
            "toy", submaps, truth, truth, q, SPACING, dataclasses.replace(SETTINGS, draws=draws), REGISTRATION
        )
        for draws in (1, 3)
    )
    assert [len(survey_graph_.draws) for survey_graph_ in (single, three)] == [1, 3]
    assert three.closures.correction.tobytes() == single.closures.correction.tobytes()
    starts = [draw.start for draw in three.draws]
    assert all(np.abs(a - b).min() > 0 for a, b in itertools.combinations(starts, 2))


def test_a_submap_without_covariance_that_closes_a_loop_is_named():
    _, survey_graph_ = graph()
    q = {int(n): np.eye(2) for n in survey_graph_.number if n != survey_graph_.closures.node[0]}
    with pytest.raises(survey_graph.SurveyGraphError, match=f"submap {survey_graph_.closures.node[0]} closes"):
        survey_graph.edge_covariances(survey_graph_.number, q, survey_graph_.closures, "toy")


def test_submaps_without_poses_are_refused():
    submaps, truth = sail(1, 3)
    with pytest.raises(loop_closure.LoopClosureError, match="3 submaps and 2 poses"):
        loop_closure.close(submaps, truth[:2], None, SPACING, SETTINGS, REGISTRATION)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("cell_factor", 1e-9), ("cell_factor", 1e9), ("prior_variance_m2", 1e300), ("prior_variance_m2", -1.0)),
        *(("prior_yaw_sigma_rad", 9.0), ("coverage", 1.1), ("coverage", 0.0), ("overlap_factor", 0.0), ("draws", 0)),
    ],
)
def test_settings_without_sense_are_refused(name: str, value: float):
    with pytest.raises(ValueError, match=f"^{name} is"):
        dataclasses.replace(SETTINGS, **{name: value})


def test_a_method_that_is_none_and_map_without_a_prior_are_refused():
    with pytest.raises(ValueError, match="method is 'icp', must be gicp or map"):
        dataclasses.replace(SETTINGS, method="icp")
    with pytest.raises(ValueError, match="prior_variance_m2 is"):
        dataclasses.replace(BY_MAP, prior_variance_m2=0.0)


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_loop_closures_are_those_of_algorithm_1_as_the_paper_writes_it(dof: str):
    registration = dataclasses.replace(REGISTRATION, dof=dof, tolerance_m=1e-6, max_iterations=200)
    submaps, truth = sail(3, 3)
    starts = loop_closure.starts("toy", submaps, SETTINGS, registration.dimensions)
    closures = loop_closure.close(submaps, truth, starts, SPACING, SETTINGS, registration)
    graph: list[reference.Node] = []
    edges = []
    for i, (submap, T, start) in enumerate(zip(submaps, truth, starts, strict=True)):
        perturbation = SE2.from_vector(np.pad(start, (0, 3 - len(start))))
        added = reference.add(graph, reference.Node(submap.points, T), perturbation, SPACING, SETTINGS, registration)
        edges += [(k, i, T_target_source) for k, T_target_source in added]
    assert len(edges) > 3
    assert closures.edges.target.tolist() == [target for target, _, _ in edges]
    assert closures.edges.source.tolist() == [source for _, source, _ in edges]
    assert closures.edges.T_target_source == pytest.approx(np.array([T for _, _, T in edges]), abs=2e-3)
