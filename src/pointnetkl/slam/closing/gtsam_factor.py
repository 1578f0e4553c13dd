"""A loop closure as factors of GTSAM, for graphs of other makers: between-factors with square-root information."""

import gtsam
import numpy as np

from pointnetkl.slam.closing.estimate import Closure, to_matrices
from pointnetkl.surveys.se2 import rotate


def between(closure: Closure, navigation: np.ndarray) -> gtsam.NonlinearFactorGraph:
    """Return a factor of rank 0 to 2 from each target to the source, between poses in space.

    With one target it is the closure to first order. With several each has its share of the information, which also
    holds the targets to each other as they lay when they were tied. Roll, pitch, z and yaw are left to other factors.

    Args:
        closure: whose poses at its time are `closure.tie.tied`.
        navigation: T_map_submap (n, 4, 4), which z, roll and pitch are taken from.
    """
    tie, factors = closure.tie, gtsam.NonlinearFactorGraph()
    if not closure.rank:
        return factors
    T_map_source = _source(closure, navigation[tie.source])
    yaw = np.arctan2(T_map_source[1, 0], T_map_source[0, 0])
    R = rotate(np.eye(2), yaw).T
    information = np.zeros((6, 6))
    information[: closure.rank, 3:5] = closure.A @ R
    information[: closure.rank, 2] = closure.A @ R @ [-tie.lever[1], tie.lever[0]]  # a turn moves the lever
    for k, share, tied in zip(tie.targets, tie.shares, tie.tied, strict=True):
        T_target_source = np.linalg.inv(to_matrices(tied[None], navigation[[k]])[0]) @ T_map_source
        # False: or GTSAM takes a diagonal matrix with a 0 for standard deviations, and refuses or misreads it
        model = gtsam.noiseModel.Gaussian.SqrtInformation(np.sqrt(share) * information, False)
        factors.add(gtsam.BetweenFactorPose3(int(k), tie.source, gtsam.Pose3(T_target_source), model))
    return factors


def _source(closure: Closure, T_map_source: np.ndarray) -> np.ndarray:
    """Return the pose of the source at which the residual is 0: where it was tied, moved by the ground's pull."""
    tie = closure.tie
    moved = to_matrices(tie.tied_source[None], T_map_source[None])[0]
    moved[:2, 3] += np.linalg.pinv(closure.A) @ closure.c
    return np.asarray(moved)
