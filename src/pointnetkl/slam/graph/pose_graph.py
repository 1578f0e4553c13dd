"""Pose graphs of submaps, optimised with GTSAM (the PoseSLAM of the paper's Eq. 13).

The noise of an edge from a to b is in b's frame, rotation first (see `pose`). So a loop closure runs from the target k
to the source i, and Q_i, which is in submap i's frame, enters unchanged.
"""

import dataclasses
import functools
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy import linalg

from pointnetkl.slam.graph import gtsam_search
from pointnetkl.surveys.se2 import SE2
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_within

XY_YAW = np.array([3, 4, 2])  # indices of x, y and yaw in a tangent vector
# Beside variances of 1e-6 m^2 Cholesky cannot solve the system. Levenberg-Marquardt takes that for a bad step, and
# ends anywhere without an error. QR solves it, four times as slowly; from far away it may still end in a wrong basin.
_CHOLESKY, _QR = "MULTIFRONTAL_CHOLESKY", "MULTIFRONTAL_QR"
_SOFTENING_M2 = 1e-2
_ITERATIONS = 20


class PoseGraphError(PointNetKLError):
    """A pose graph cannot be optimised."""


class _Noise:
    def __post_init__(self) -> None:
        """Refuse standard deviations that are not positive, or too large or small to weigh against others."""
        require_within(self, 1e-9, 1e6, *vars(self))


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
    """Standard deviations of a loop closure in all but x and y, which have Q; so has yaw where it is registered."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    z_m: float


@dataclass(frozen=True)
class Edges:
    """Measured relative poses between nodes; nodes count from 0."""

    target: np.ndarray  # (e,)
    source: np.ndarray  # (e,)
    T_target_source: np.ndarray  # (e, 4, 4)


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

    q (e, 3, 3) covers yaw too. It is then about `levers` (e, 2), metres in the source's frame, and is moved to that
    frame's origin.
    """
    full = np.zeros((len(q), 6, 6))
    full[:, range(6), range(6)] = np.array([noise.roll_rad, noise.pitch_rad, noise.yaw_rad, 0.0, 0.0, noise.z_m]) ** 2
    if levers is None:
        full[:, 3:5, 3:5] = q
        return full
    adjoint = SE2(levers, 0.0).adjoint()
    full[:, XY_YAW[:, None], XY_YAW] = adjoint @ q @ np.swapaxes(adjoint, 1, 2)
    return full


class Odometry:
    """Dead reckoning, which the graphs of all methods share: its factors, and the poses where the search starts."""

    def __init__(self, relative: np.ndarray, noise: DeadReckoningNoise, initial: np.ndarray) -> None:
        """Take each node's pose in the frame of the one before (n - 1, 4, 4), and initial T_map_submap (n, 4, 4)."""
        model = gtsam.noiseModel.Diagonal.Sigmas(sigmas(noise))
        self.factors, self.initial = gtsam.NonlinearFactorGraph(), gtsam_search.to_values(initial)
        for node, T in enumerate(relative):
            self.factors.add(gtsam.BetweenFactorPose3(node, node + 1, gtsam.Pose3(T), model))


class PoseGraph:
    """The factors that no corruption changes: a held first node, and loop closures."""

    def __init__(self, first: np.ndarray, closures: Edges, covariances: np.ndarray) -> None:
        """Hold node 0 at `first` (4, 4) and add closures with covariances (e, 6, 6) in their sources' frames.

        GTSAM accepts an indefinite covariance without an error: check Q before.
        """
        self._arguments = first, closures, covariances
        self._fixed = _fixed(first, closures, covariances)
        self._stiff = False  # whether Cholesky has failed

    def optimise(self, dead_reckoning: np.ndarray, noise: DeadReckoningNoise, initial: np.ndarray) -> np.ndarray:
        """Return the most likely poses (n, 4, 4) from initial ones (n, 4, 4), as `solve` does.

        `dead_reckoning` (n - 1, 4, 4) is each node's pose in the frame of the one before.
        """
        return self.solve(Odometry(dead_reckoning, noise, initial))

    def solve(self, odometry: Odometry) -> np.ndarray:
        """Return the most likely poses (n, 4, 4), by Levenberg-Marquardt.

        Raises:
            PoseGraphError: it ends at no minimum.
        """
        graph = gtsam_search.join(self._fixed, odometry.factors)
        poses = None if self._stiff else _minimum(graph, odometry.initial, _CHOLESKY)
        if poses is None:
            self._stiff = True  # under other noise it would fail again
            near = _minimum(gtsam_search.join(self._soft, odometry.factors), odometry.initial, _CHOLESKY)
            poses = None if near is None else _minimum(graph, gtsam_search.to_values(near), _QR)
        if poses is None:
            raise PoseGraphError(
                f"a graph of {odometry.initial.size()} nodes has no solution: the search ends at no minimum; look for"
                " covariances that are next to singular"
            )
        return poses

    def position_covariances(self, odometry: Odometry, poses: np.ndarray) -> np.ndarray:
        """Return the covariances (n, 2, 2) of x, y, m^2 in the map, which the graph claims for poses (n, 4, 4)."""
        solution = gtsam_search.to_values(poses)
        linear = gtsam_search.join(self._fixed, odometry.factors).linearize(solution)
        try:
            marginals = gtsam.Marginals(linear, solution)
            in_node = np.array([marginals.marginalCovariance(node) for node in range(len(poses))])
        except RuntimeError:  # singular, to Cholesky
            in_node = _marginals(linear)
        R = poses[:, :3, :3]  # a marginal is in its node's own frame
        return np.asarray((R @ in_node[:, 3:, 3:] @ np.swapaxes(R, 1, 2))[:, :2, :2])

    @functools.cached_property
    def _soft(self) -> gtsam.NonlinearFactorGraph:
        """Return the factors with less certain closures: their solution is near, and in the right basin."""
        first, closures, covariances = self._arguments
        softening = np.diag([0.0, 0.0, 0.0, _SOFTENING_M2, _SOFTENING_M2, 0.0])
        return _fixed(first, closures, covariances + softening)


def _fixed(first: np.ndarray, closures: Edges, covariances: np.ndarray) -> gtsam.NonlinearFactorGraph:
    factors = gtsam_search.hold({0: first})
    for k, i, T, covariance in zip(
        closures.target, closures.source, closures.T_target_source, covariances, strict=True
    ):
        model = gtsam.noiseModel.Gaussian.Covariance(covariance)
        factors.add(gtsam.BetweenFactorPose3(int(k), int(i), gtsam.Pose3(T), model))
    return factors


def _minimum(graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, solver: str) -> np.ndarray | None:
    search = gtsam.LevenbergMarquardtParams()
    search.setMaxIterations(_ITERATIONS)
    search.setLinearSolverType(solver)
    return gtsam_search.minimum(graph, initial, search)


def _marginals(linear: gtsam.GaussianFactorGraph) -> np.ndarray:
    """Return the nodes' covariances (n, 6, 6), by QR."""
    order = gtsam.Ordering.NaturalGaussianFactorGraph(linear)
    root, _ = linear.eliminateSequential(order, gtsam.EliminateQR).matrix()
    blocks = linalg.solve_triangular(root, np.eye(len(root))).reshape(-1, 6, len(root))
    return blocks @ np.swapaxes(blocks, 1, 2)
