"""Builds a survey's pose graph: GT, which stands for the truth in the paper, then draws of Algorithm 1 on it."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.slam.closures import loop_closure
from pointnetkl.slam.graph import pose_graph, survey_graph
from pointnetkl.slam.graph.survey_graph import Closures, SurveyGraph
from pointnetkl.surveys import submap
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import compute
from pointnetkl.workflow.errors import PointNetKLError


class GraphConstructionError(PointNetKLError):
    """A survey's truth does not cover it."""


def true_poses(submaps: pd.DataFrame, pings: pd.DataFrame, trajectory: pd.DataFrame) -> np.ndarray:
    """Return the true poses (n, 4, 4) of submaps, by linear interpolation in time; NaN if the trajectory is empty.

    A submap's yaw is that of its track by navigation, not the vehicle's heading. Its error is that of the heading in
    `pings` (columns time_s, yaw_rad). `submaps` has time_s and yaw_rad, the trajectory is of survey.TRAJECTORY.

    Raises:
        GraphConstructionError: a time lies outside the trajectory.
    """
    times = submaps["time_s"].to_numpy()
    if trajectory.empty:
        return np.full((len(times), 4, 4), np.nan)
    true_times = trajectory["time_s"].to_numpy()
    if len(outside := times[(times < true_times[0]) | (times > true_times[-1])]):
        raise GraphConstructionError(
            f"the truth covers {true_times[0]:.3f} to {true_times[-1]:.3f} s and a submap is at {outside[0]:.3f} s;"
            " give a truth of the whole survey, or data/none"
        )
    columns = {name: np.interp(times, true_times, trajectory[name]) for name in ("x_m", "y_m", "z_m")}
    error = _heading(times, pings) - _heading(times, trajectory)
    return submap.poses_from_table(pd.DataFrame({**columns, "yaw_rad": submaps["yaw_rad"].to_numpy() - error}))


def _heading(times: np.ndarray, trajectory: pd.DataFrame) -> np.ndarray:
    return np.interp(times, trajectory["time_s"], np.unwrap(trajectory["yaw_rad"]))


def label_covariances(labels: pd.DataFrame, survey: str) -> dict[int, np.ndarray]:
    """Return the Monte Carlo covariances (M, M) of a table of labels, by submap.

    Raises:
        CovarianceError: one of them is not a covariance.
    """
    numbers, matrices = labels["submap"].tolist(), table.to_matrices(labels)
    return {
        number: gaussian.check(q, f"{survey}, label of submap {number}")
        for number, q in zip(numbers, matrices, strict=True)
    }


def build(
    survey: str,
    submaps: Sequence[Submap],
    navigation: np.ndarray,
    truth: np.ndarray,
    labels: Mapping[int, np.ndarray],
    spacing: float,
    settings: loop_closure.Settings,
    registration: gicp.Settings,
) -> SurveyGraph:
    """Return a survey's graph: GT from navigation (n, 4, 4), then each draw of Algorithm 1 on the GT poses.

    `labels` are the Monte Carlo covariances (M, M) by submap; `spacing` is that of neighbouring points, in metres.
    """
    number = np.array([s.number for s in submaps], np.int64)
    closures = loop_closure.close(submaps, navigation, None, spacing, settings, registration)
    full = survey_graph.full_covariances(number, labels, closures, settings.loop_closure, f"{survey}, labels")
    gt = optimise_navigation(navigation, closures, full, settings)

    def close(draw: int) -> Closures:
        starts = loop_closure.starts(survey, submaps, settings, registration.dimensions, draw)
        return loop_closure.close(submaps, gt, starts, spacing, settings, registration)

    draws = compute.in_threads(close, range(settings.draws), f"loop closures, {survey}", unit="draw")
    noise = (settings.dead_reckoning, settings.loop_closure)
    return SurveyGraph(survey, number, navigation, gt, truth, tuple(draws), *noise)


def without_track(
    survey: str,
    submaps: Sequence[Submap],
    poses: np.ndarray,
    spacing: float,
    settings: loop_closure.Settings,
    registration: gicp.Settings,
) -> SurveyGraph:
    """Return the graph, without edges, of submaps at poses (n, 4, 4) that do not follow each other on a track."""
    number, unknown = np.array([s.number for s in submaps], np.int64), np.full_like(poses, np.nan)
    none = loop_closure.close([], poses[:0], None, spacing, settings, registration)
    if none.centroid is not None:  # with yaw every node has one
        none = dataclasses.replace(none, centroid=np.array([s.points[:, :2].mean(axis=0) for s in submaps]))
    noise = (settings.dead_reckoning, settings.loop_closure)
    return SurveyGraph(survey, number, poses, poses, unknown, (none,) * settings.draws, *noise, track=False)


def optimise_navigation(
    navigation: np.ndarray, closures: Closures, covariances: np.ndarray, settings: loop_closure.Settings
) -> np.ndarray:
    """Return "GT" (n, 4, 4): navigation optimised with loop closures of covariances (e, 6, 6)."""
    graph = pose_graph.PoseGraph(navigation[0], closures.edges, covariances)
    return graph.optimise(pose_graph.between(navigation), settings.dead_reckoning, navigation)
