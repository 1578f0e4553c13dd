"""The corrected track as TUM, and the submaps' poses with covariances as text."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import Corrected, Submaps
from pointnetkl.exchange import tum
from pointnetkl.surveys import pose
from pointnetkl.workflow import artifacts

# of pose.py's order, rotation first
_AXES = ("roll", "pitch", "yaw", "x", "y", "z")
_ESTIMATED = np.array([3, 4, 2])  # x, y, yaw, the order of Submaps.covariance
_UPPER = np.triu_indices(6)


def write_tum(path: Path, track: Placed) -> None:
    """Write the corrected pose of the vehicle at each time; pings at equal times count once.

    Raises:
        ArtifactError: the file cannot be written.
    """
    rows = track.moments
    comment = (
        f"{_times(track.has_times)}; {frame_of(track.crs, track.origin)}; the body's x is forward, y to port, z up;"
        " roll and pitch as recorded (port side up, bow up), 0 where they are not"
    )
    tum.write(path, track.time_s[rows], bodies(track)[rows], comment)


def bodies(track: Placed) -> np.ndarray:
    """Return corrected poses T_map_body (n, 4, 4) of a track: x forward, y to port, z up."""
    angles = np.column_stack([track.after[:, 2], -track.column("pitch_rad"), track.column("roll_rad")])
    poses = np.tile(np.eye(4), (len(angles), 1, 1))
    if len(angles):
        poses[:, :3, :3] = Rotation.from_euler("ZYX", np.nan_to_num(angles)).as_matrix()
    poses[:, :2, 3], poses[:, 2, 3] = track.after[:, :2], track.z_m
    return poses


def write_covariances(path: Path, corrected: Corrected, submaps: Submaps) -> None:
    """Write a line per submap: its time, its corrected pose, and the upper triangle of its covariance.

    Raises:
        ArtifactError: the file cannot be written.
    """
    placed = Placed(corrected)
    full = np.full((len(submaps.number), 6, 6), np.nan)
    full[:, _ESTIMATED[:, None], _ESTIMATED] = submaps.covariance
    places, turns = submaps.after[:, :3, 3], pose.quaternions(submaps.after)
    rows = np.column_stack([submaps.time_s, places, turns, full[:, *_UPPER]])
    names = " ".join(f"P_{_AXES[i]}_{_AXES[j]}" for i, j in zip(*_UPPER, strict=True))
    lines = [
        f"# t tx ty tz qx qy qz qw {names}",
        f"# {_times(placed.has_times)}, of a submap's middle; {frame_of(corrected.crs, placed.origin)};"
        " covariances in rad^2, rad m and m^2, of errors in the axes of the map, yaw about z;"
        " nan: z, roll and pitch are measured and stay, and their variances are not known",
        *(" ".join(map(repr, row)) for row in rows.tolist()),
    ]
    artifacts.write_bytes(path, ("\n".join(lines) + "\n").encode())


def frame_of(crs: str, origin: np.ndarray) -> str:
    """Return what the map frame is, for a comment."""
    east, north = origin.tolist()
    return f"x east, y north, z up, in metres from the origin {east!r} {north!r} of {crs}"


def _times(are_true: bool) -> str:
    return "t in UTC seconds since 1970" if are_true else "t counts the submaps, the survey has no times"
