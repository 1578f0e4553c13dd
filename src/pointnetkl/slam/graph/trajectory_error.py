"""Errors of a trajectory's positions against a reference, as they are and after alignment."""

import numpy as np


def rmse(estimate: np.ndarray, reference: np.ndarray) -> float:
    """Return sqrt(mean |d|^2) over positions (n, 2 or 3), unaligned; NaN where the reference is unknown."""
    return float(np.sqrt(np.mean(np.sum((estimate - reference) ** 2, axis=1))))


def align_se2(estimate: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return positions (n, 3) after the rotation about z and the shift in x, y that fit a reference best."""
    a, b = estimate[:, :2], reference[:, :2]
    centred, target = a - a.mean(axis=0), b - b.mean(axis=0)
    cross = centred.T @ target
    # the rotation that maximises the trace of R cross: in the plane, one arctangent
    angle = np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1])
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([centred @ R.T + b.mean(axis=0), estimate[:, 2]])


def align_4dof(estimate: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return positions (n, 3) after the rotation about z and the shift that fit a reference (n, 3) best."""
    aligned = align_se2(estimate, reference)
    aligned[:, 2] += np.mean(reference[:, 2] - estimate[:, 2])
    return aligned
