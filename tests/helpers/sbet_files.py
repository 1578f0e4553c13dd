"""SBET files of a vessel under way."""

from pathlib import Path

import numpy as np


def records(time: np.ndarray) -> np.ndarray:
    """Return SBET records of a vessel that turns through north while it crosses the date line."""
    table = np.zeros((len(time), 17))
    run = np.arange(len(time)) / len(time)
    table[:, 0], table[:, 1] = time, np.deg2rad(-20 + 0.01 * run)
    table[:, 2] = np.deg2rad(np.mod(179.995 + 0.01 * run + 180, 360) - 180)
    table[:, 3], table[:, 4] = 12.0, 5.0
    table[:, 7], table[:, 8] = 0.01 * run, -0.02 * run
    table[:, 9], table[:, 10] = np.deg2rad(np.mod(350 + 20 * run, 360) + 30), np.deg2rad(30)
    return table


def write(path: Path, table: np.ndarray) -> Path:
    """Write SBET records."""
    path.write_bytes(table.astype("<f8").tobytes())
    return path
