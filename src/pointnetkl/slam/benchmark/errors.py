"""Errors of one solution of the SLAM benchmark, against GT and the truth, and whether it claims them rightly."""

from collections.abc import Iterator

import numpy as np

from pointnetkl.registration.covariance import gaussian
from pointnetkl.slam.graph import trajectory_error
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.graph.survey_graph import SurveyGraph

_CHI2_2_MEDIAN = 2 * np.log(2)  # of e^T C^-1 e, two degrees of freedom, where C is right


def errors(graph: SurveyGraph, edges: Edges, poses: np.ndarray) -> dict[str, float]:
    """Return the errors of poses (n, 4, 4) in metres, by the names of schemas.ROWS; NaN where the truth is not known.

    Each in three ways: as it is, after the best motion in the plane (SE(2)), and after the best motion in the plane
    and in height (4-DoF). `truth_relative_m` is of the pairs that `edges` join.
    """
    rmses = {**dict(_rmses("", poses, graph.gt)), **dict(_rmses("truth_", poses, graph.truth))}
    return {**rmses, "truth_relative_m": relative_error(edges, poses, graph.truth)}


def relative_error(edges: Edges, poses: np.ndarray, reference: np.ndarray) -> float:
    """Return the rms error of each edge's source in x, y of its target's frame, metres; NaN without edges.

    `poses` and `reference` are T_map_submap (n, 4, 4). A rotation of the whole map, which no loop closure can correct,
    does not count.
    """
    if len(edges.source) == 0:
        return float("nan")
    T_target_source, expected = (np.linalg.inv(T[edges.target]) @ T[edges.source] for T in (poses, reference))
    return trajectory_error.rmse(T_target_source[:, :2, 3], expected[:, :2, 3])


def pose_nees(covariances: np.ndarray, poses: np.ndarray, reference: np.ndarray) -> float:
    """Return the median over submaps of e^T C^-1 e, as a multiple of the median of a chi-squared variable.

    e is the error of poses (n, 4, 4) in x, y; C is one of `covariances` (n, 2, 2), which the solution claims for e. The
    solution holds its first submap: `reference` is moved to it, and that submap left out. 1 is right, more is
    overconfident.
    """
    expected = poses[0] @ np.linalg.inv(reference[0]) @ reference
    error = (poses - expected)[1:, None, :2, 3]
    return float(np.median(gaussian.squared_mahalanobis(error, covariances[1:])) / _CHI2_2_MEDIAN)


def _rmses(prefix: str, poses: np.ndarray, reference: np.ndarray) -> Iterator[tuple[str, float]]:
    position, expected = poses[:, :3, 3], reference[:, :3, 3]
    yield f"{prefix}rmse_xyz_m", trajectory_error.rmse(position, expected)
    yield f"{prefix}rmse_se2_m", trajectory_error.rmse(trajectory_error.align_se2(position, expected), expected)
    yield f"{prefix}rmse_4dof_m", trajectory_error.rmse(trajectory_error.align_4dof(position, expected), expected)
