"""What one solution of the SLAM benchmark is judged by: errors against GT and the truth, and its own claim."""

from collections.abc import Iterator

import numpy as np

from pointnetkl.registration.covariance import gaussian
from pointnetkl.slam.graph import trajectory_error
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.graph.survey_graph import SurveyGraph

_CHI2_2_MEDIAN = 2 * np.log(2)  # of e^T C^-1 e, two degrees of freedom, where C is right


def errors(graph: SurveyGraph, edges: Edges, poses: np.ndarray) -> dict[str, float]:
    """Return the errors of poses (n, 4, 4) in metres, by the names of tables.ROWS; NaN where the truth is not known.

    Each in three ways: as it is, turned and moved in the plane to fit best (SE(2)), and with height moved too
    (4-DoF). `truth_relative_m` is of the pairs that `edges` join.
    """
    found = {**dict(_rmse("", poses, graph.gt)), **dict(_rmse("truth_", poses, graph.truth))}
    return {**found, "truth_relative_m": relative_error(edges, poses, graph.truth)}


def relative_error(edges: Edges, poses: np.ndarray, reference: np.ndarray) -> float:
    """Return the rms error of each edge's source in x, y of its target's frame, metres; NaN without edges.

    `poses` and `reference` are T_map_submap (n, 4, 4). A turn of the whole map, which no loop closure sees, is not in
    it.
    """
    if len(edges.source) == 0:
        return float("nan")
    seen, due = (np.linalg.inv(T[edges.target]) @ T[edges.source] for T in (poses, reference))
    return trajectory_error.rmse(seen[:, :2, 3], due[:, :2, 3])


def pose_nees(covariances: np.ndarray, poses: np.ndarray, reference: np.ndarray) -> float:
    """Return the median of e^T C^-1 e over submaps, e the error of poses (n, 4, 4) in x, y, over a chi-squared's.

    `covariances` (n, 2, 2) are those of the solution, which holds its first submap where `poses` has it: `reference` is
    moved there, and that submap left out. 1 is right, more is overconfident.
    """
    due = poses[0] @ np.linalg.inv(reference[0]) @ reference
    off = (poses - due)[1:, None, :2, 3]
    return float(np.median(gaussian.squared_mahalanobis(off, covariances[1:])) / _CHI2_2_MEDIAN)


def _rmse(prefix: str, poses: np.ndarray, reference: np.ndarray) -> Iterator[tuple[str, float]]:
    position, goal = poses[:, :3, 3], reference[:, :3, 3]
    yield f"{prefix}rmse_xyz_m", trajectory_error.rmse(position, goal)
    yield f"{prefix}rmse_se2_m", trajectory_error.rmse(trajectory_error.align_se2(position, goal), goal)
    yield f"{prefix}rmse_4dof_m", trajectory_error.rmse(trajectory_error.align_4dof(position, goal), goal)
