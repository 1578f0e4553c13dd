"""The sizes of surveys."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.reporting.results import Labels
from pointnetkl.slam.graph import footprint
from pointnetkl.surveys import pose, survey, voxel


def dataset(
    clouds: Sequence[np.ndarray],
    poses: pd.DataFrame,
    pings: pd.DataFrame,
    labels: Labels,
    canonical: voxel.Clouds,
    cell_m: float,
) -> dict[str, Any]:
    """Return a survey's size and density: clouds (n_i, 3) in submap frames, poses and pings by navigation."""
    counts = np.array([len(points) for points in clouds])
    return {
        "submaps": len(clouds),
        "area_km2": area_km2(clouds, poses, cell_m),
        "track_km": survey.track_length(pings) / 1e3 if len(pings) else None,
        "sigma_z": voxel.sigma_z(canonical),
        "points_mean": float(counts.mean()),
        "points_std": float(counts.std()),
        "spacing_m": float(np.median(labels.spacing_m)),
    }


def area_km2(clouds: Sequence[np.ndarray], poses: pd.DataFrame, cell_m: float) -> float:
    """Return the area of the union of the submaps' footprints: cells of `cell_m` metres that hold a point."""
    clouds_in_map = (
        footprint.cells(pose.transform(pose.matrix(np.array([row.x_m, row.y_m, row.z_m]), row.yaw_rad), points), cell_m)
        for row, points in zip(poses.itertuples(), clouds, strict=True)
    )
    return len(np.unique(np.concatenate(list(clouds_in_map)))) * cell_m**2 / 1e6
