"""Seabeds to register on: points spread evenly over a square, heights from flat to rugged, or a ridge."""

import numpy as np

AMPLITUDES_M = {"flat": 0.0, "gentle": 0.1, "mild": 0.5, "rugged": 2.0}


def cloud(kind: str, points: int, pass_number: int = 0, size_m: float = 100.0) -> np.ndarray:
    """Return about `points` points (n, 3) of a seabed; other passes are other points of the same ground."""
    rng = np.random.default_rng([7, pass_number])
    edge = size_m / np.sqrt(points)
    corners = np.stack(np.meshgrid(*2 * [np.arange(-size_m / 2, size_m / 2, edge)]), -1).reshape(-1, 2)
    xy = corners + edge * rng.random(corners.shape)
    return np.column_stack([xy, height(kind, xy)])


def height(kind: str, xy: np.ndarray) -> np.ndarray:
    """Return heights (n,) in metres: a ridge along x, or a sum of waves some 20 m long."""
    if kind == "ridge":
        return np.asarray(3 * np.exp(-((xy[:, 1] / 6) ** 2)))
    rng = np.random.default_rng(1)
    waves, phases = rng.normal(size=(40, 2)) * 2 * np.pi / 20, rng.uniform(0, 2 * np.pi, 40)
    return np.asarray(AMPLITUDES_M[kind] * np.sqrt(2 / 40) * np.cos(xy @ waves.T + phases).sum(axis=1))
