"""Trajectories as TUM files, which evo and others read: a line `seconds x y z qx qy qz qw` for each pose."""

from pathlib import Path

import numpy as np

from pointnetkl.readers.formats import text_lines
from pointnetkl.surveys import pose
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError


class TumError(PointNetKLError):
    """A file is not a trajectory."""


def write(path: Path, time_s: np.ndarray, poses: np.ndarray, times_are: str) -> None:
    """Write poses T_map_body (n, 4, 4) at times (n,) with all digits; a comment first says what `times_are`.

    Raises:
        ArtifactError: the file cannot be written.
    """
    rows = np.column_stack([time_s, poses[:, :3, 3], pose.quaternions(poses)])
    lines = [
        f"# {times_are}; x y z in metres in the map frame, qx qy qz qw",
        *(" ".join(map(repr, row)) for row in rows.tolist()),
    ]
    artifacts.write_bytes(path, ("\n".join(lines) + "\n").encode())


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the times (n,) in seconds and the poses T_map_body (n, 4, 4) of a file.

    Raises:
        TumError: the file is missing, damaged or empty, or its times do not increase.
    """
    lines = [(line, words) for line, words in text_lines.read(path, TumError) if words[0][0] != "#"]
    if not lines:
        raise TumError(f"{path}: has no pose; it is not a trajectory, or it is cut off")
    rows = np.array([_numbers(path, line, words) for line, words in lines])
    increasing = np.diff(rows[:, 0], prepend=-np.inf) > 0
    for good, cause in (
        (pose.are_unit(rows[:, 4:]), "its quaternion has not length 1; the order is qx qy qz qw"),
        (increasing, "its time is not later than the one before"),
    ):
        if not good.all():
            raise TumError(f"{path}: line {lines[int(good.argmin())][0]}: {cause}")
    return rows[:, 0], pose.from_quaternions(rows[:, 1:4], rows[:, 4:])


def _numbers(path: Path, line: int, words: list[str]) -> list[float]:
    try:
        if len(words) != 8:
            raise ValueError(f"it has {len(words)} words, must have 8: seconds x y z qx qy qz qw")
        return text_lines.numbers(words)
    except ValueError as error:
        raise TumError(f"{path}: line {line}: {error}") from error
