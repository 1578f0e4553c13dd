"""Poses in the plane of a map, in SE(3) form; motions within the plane are in `se2`.

The map frame is local east, north, up. A submap's frame is levelled: x along the track, y to port, z up; its
pose in the map is a position and a yaw, counter-clockwise from east. `T_map_submap` takes coordinates from the
submap's frame to the map's: names are read right to left. Tangent vectors are rotation first, translation
second, as in GTSAM's Pose3: (roll, pitch, yaw, x, y, z). Errors of a registration, and their covariances, have x and
y first, as the paper has them, and then yaw, where it is registered.
"""

import numpy as np
from scipy.spatial.transform import Rotation

_LOOSEST = 1e-3  # from the length 1 of a quaternion: files of few digits are that far off; more is damage


def matrix(position: np.ndarray, yaw: float) -> np.ndarray:
    """Return the 4 x 4 transform of a levelled frame at `position` (3,) metres, turned by `yaw` radians."""
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = position
    return T


def transform(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) transformed by the 4 x 4 transform T."""
    return points @ T[:3, :3].T + T[:3, 3]


def yaw_of(T: np.ndarray) -> float:
    """Return the yaw of a transform, in radians."""
    return float(np.arctan2(T[1, 0], T[0, 0]))


def heading_to_yaw(heading: np.ndarray) -> np.ndarray:
    """Turn compass headings (radians, clockwise from north) into yaws (counter-clockwise from east)."""
    return np.arctan2(np.cos(heading), np.sin(heading))  # atan2(north part, east part)


def quaternions(poses: np.ndarray) -> np.ndarray:
    """Return the orientations of transforms (n, 4, 4) as unit quaternions (n, 4): x, y, z, w, with w not negative."""
    return np.asarray(Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)).reshape(-1, 4)


def are_unit(quaternions: np.ndarray) -> np.ndarray:
    """Return whether (n,) each of the quaternions (n, 4) has length 1, up to the digits that a file may lack."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.abs(np.linalg.norm(quaternions, axis=-1) - 1) < _LOOSEST)


def from_quaternions(positions: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """Return transforms (n, 4, 4) of positions (n, 3) and quaternions (n, 4: x, y, z, w), scaled to length 1."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    if len(positions):
        poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
        poses[:, :3, 3] = positions
    return poses
