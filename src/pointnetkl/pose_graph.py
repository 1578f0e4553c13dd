"""Pose graphs of submaps, optimised with GTSAM (the PoseSLAM of the paper's Eq. 13).

The noise of an edge from a to b stands in b's frame, rotation first (see `pose`). So a loop closure runs from
the target k to the source i, and Q_i, which is in submap i's frame, enters as it is.
"""

import dataclasses
from dataclasses import dataclass

import gtsam
import numpy as np

from pointnetkl.errors import PointNetKLError
from pointnetkl.settings import require_positive

_XY_YAW = np.array([3, 4, 2])  # places of x, y and yaw in a tangent vector
_FIRST_POSE_SIGMA = 1e-6  # metres and radians: the first node is held, and this says how


class PoseGraphError(PointNetKLError):
    """A pose graph cannot be optimised."""


class _Noise:
    def __post_init__(self) -> None:
        """Refuse standard deviations that are not positive."""
        require_positive(self, *vars(self))


@dataclass(frozen=True)
class DeadReckoningNoise(_Noise):
    """Standard deviations of the pose of a submap relative to the one before."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    x_m: float
    y_m: float
    z_m: float


@dataclass(frozen=True)
class ClosureNoise(_Noise):
    """Standard deviations of a loop closure in all but x and y, which have Q; yaw has it too, where it is found."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    z_m: float


@dataclass(frozen=True)
class Edges:
    """Measured relative poses between nodes, counted from 0."""

    target: np.ndarray  # (e,)
    source: np.ndarray  # (e,)
    measured: np.ndarray  # (e, 4, 4) T_target_source


def sigmas(noise: DeadReckoningNoise | ClosureNoise) -> np.ndarray:
    """Return the standard deviations in the order of the fields: rotation first."""
    return np.array(dataclasses.astuple(noise))


def between(poses: np.ndarray) -> np.ndarray:
    """Return the pose of each node in the frame of the one before, (n - 1, 4, 4), of T_map_submap (n, 4, 4)."""
    return np.asarray(np.linalg.inv(poses[:-1]) @ poses[1:])


def chain(first: np.ndarray, relative: np.ndarray) -> np.ndarray:
    """Return T_map_submap (n, 4, 4): dead reckoning from the first pose (4, 4) along (n - 1, 4, 4)."""
    poses = [first]
    for T_before_node in relative:
        poses.append(poses[-1] @ T_before_node)
    return np.array(poses)


def closure_covariances(q: np.ndarray, noise: ClosureNoise, levers: np.ndarray | None = None) -> np.ndarray:
    """Return the edges' covariances (e, 6, 6), rotation first, with q (e, 2, 2) in m^2 for x and y.

    With q (e, 3, 3) it is yaw's too; q is then about `levers` (e, 2), metres in the source's frame, and is moved to
    that frame's origin.
    """
    full = np.zeros((len(q), 6, 6))
    full[:, range(6), range(6)] = np.array([noise.roll_rad, noise.pitch_rad, noise.yaw_rad, 0.0, 0.0, noise.z_m]) ** 2
    if levers is None:
        full[:, 3:5, 3:5] = q
        return full
    adjoint = np.tile(np.eye(3), (len(q), 1, 1))  # of x, y, yaw
    adjoint[:, :2, 2] = levers[:, ::-1] * [1, -1]
    full[:, _XY_YAW[:, None], _XY_YAW] = adjoint @ q @ np.swapaxes(adjoint, 1, 2)
    return full


class PoseGraph:
    """The edges that do not change from one corruption to the next: a held first node, and loop closures."""

    def __init__(self, first: np.ndarray, closures: Edges, covariances: np.ndarray) -> None:
        """Hold node 0 at `first` (4, 4) and add closures with covariances (e, 6, 6) in their sources' frames.

        GTSAM takes an indefinite covariance without a word: check Q before it comes here.
        """
        held = gtsam.noiseModel.Isotropic.Sigma(6, _FIRST_POSE_SIGMA)
        self._fixed = gtsam.NonlinearFactorGraph()
        self._fixed.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(first), held))
        for k, i, T, covariance in zip(closures.target, closures.source, closures.measured, covariances, strict=True):
            model = gtsam.noiseModel.Gaussian.Covariance(covariance)
            self._fixed.add(gtsam.BetweenFactorPose3(int(k), int(i), gtsam.Pose3(T), model))

    def optimise(self, dead_reckoning: np.ndarray, noise: DeadReckoningNoise, initial: np.ndarray) -> np.ndarray:
        """Return the most likely poses (n, 4, 4) by Levenberg-Marquardt, from initial ones (n, 4, 4).

        `dead_reckoning` (n - 1, 4, 4) is each node's pose in the frame of the one before.

        Raises:
            PoseGraphError: the linear system has no solution, or the answer is not finite.
        """
        graph = gtsam.NonlinearFactorGraph(self._fixed)
        _add_dead_reckoning(graph, dead_reckoning, noise)
        values = gtsam.Values()
        for node, T in enumerate(initial):
            values.insert(node, gtsam.Pose3(T))
        try:
            solution = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        except RuntimeError as error:
            cause = str(error).strip().splitlines()[0]
            raise PoseGraphError(f"a graph of {len(initial)} nodes has no solution ({cause})") from error
        return _poses(solution)


def _add_dead_reckoning(graph: gtsam.NonlinearFactorGraph, measured: np.ndarray, noise: DeadReckoningNoise) -> None:
    model = gtsam.noiseModel.Diagonal.Sigmas(sigmas(noise))
    for node, T in enumerate(measured):
        graph.add(gtsam.BetweenFactorPose3(node, node + 1, gtsam.Pose3(T), model))


def _poses(values: gtsam.Values) -> np.ndarray:
    rows = gtsam.utilities.extractPose3(values)  # by key: rotation row by row, then position
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
    if not np.isfinite(poses).all():
        raise PoseGraphError(f"a graph of {len(rows)} nodes has poses that are not numbers")
    return poses
