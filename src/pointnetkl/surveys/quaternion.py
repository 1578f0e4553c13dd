"""Orientations as unit quaternions (x, y, z, w), as files of poses have them."""

import numpy as np
from scipy.spatial.transform import Rotation

_LOOSEST = 1e-3  # files of few digits are that far from the unit length; what is farther is damaged


def of(poses: np.ndarray) -> np.ndarray:
    """Return the orientations (n, 4) of transforms (n, 4, 4), with w not negative."""
    return np.asarray(Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)).reshape(-1, 4)


def is_unit(quaternions: np.ndarray) -> np.ndarray:
    """Return which (n,) of the quaternions (n, 4) have unit length, up to the digits that a file may lack."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.abs(np.linalg.norm(quaternions, axis=-1) - 1) < _LOOSEST)


def to_poses(positions: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """Return transforms (n, 4, 4) of positions (n, 3) and quaternions (n, 4), which are brought to unit length."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    if len(positions):
        poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
        poses[:, :3, 3] = positions
    return poses
