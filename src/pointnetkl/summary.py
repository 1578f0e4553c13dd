"""The numbers of a report, `metrics.json`, from every stage's artifacts."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl import footprint, metrics, pose, survey, text_table, voxel
from pointnetkl.results import ERRORS, Labels, Test

GOLD = "monte_carlo"  # the labels themselves, as a method: their KL to themselves says nothing


@dataclass(frozen=True)
class Settings:
    """Section `report` of the parameters."""

    seed: int  # of the bootstrap
    kl_floor_m2: float  # added to label and estimate wherever KL is judged
    cell_factor: float  # a footprint's cell, in point spacings: fewer and a swath has holes


def simulated_from(raw: str, simulate: Mapping[str, Any]) -> str | None:
    """Return the entry of `simulate` that a survey's raw pings come from, None if they are somebody's own."""
    folder, name = ("", *PurePath(raw).parts)[-2:]
    return name if folder == "raw" and name in simulate else None


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
        "track_km": survey.track_length(pings) / 1e3,
        "sigma_z": voxel.sigma_z(canonical),
        "points_mean": float(counts.mean()),
        "points_std": float(counts.std()),
        "spacing_m": float(np.median(labels.spacing_m)),
    }


def area_km2(clouds: Sequence[np.ndarray], poses: pd.DataFrame, cell_m: float) -> float:
    """Return the area of the union of the submaps' footprints: cells of `cell_m` metres that hold a point."""
    placed = (
        footprint.cells(pose.transform(pose.matrix(np.array([row.x_m, row.y_m, row.z_m]), row.yaw_rad), points), cell_m)
        for row, points in zip(poses.itertuples(), clouds, strict=True)
    )
    return len(np.unique(np.concatenate(list(placed)))) * cell_m**2 / 1e6


def divergences(name: str, labels: Labels, test: Test, settings: Settings) -> dict[str, Any]:
    """Return how far each method's covariances are from the labels, nats; intervals over submaps."""
    return {
        method: metrics.kl_summary(labels.q, q, settings.kl_floor_m2, _rng(settings, name, method))
        for method, q in test.covariances.items()
        if method != GOLD
    }


def calibrations(labels: Labels, test: Test) -> dict[str, Any]:
    """Return how well each method's covariances describe the errors that no label has seen, if there are any."""
    if test.held_out.size == 0:
        return {}
    every = {GOLD: labels.q, **test.covariances}
    return {method: metrics.calibration(test.held_out, q) for method, q in every.items()}


def slam(name: str, test: Test, settings: Settings) -> dict[str, Any]:
    """Return the graph's size and each method's errors; a mean over repetitions, None where nothing is known."""
    sizes = {"dead_reckoning_edges": len(test.gt) - 1, "loop_closures": len(test.loop_closures)}
    methods = {
        str(method): _errors(rows, _rng(settings, name, str(method)))
        for method, rows in test.slam.groupby("method", sort=False)
    }
    return {**sizes, **methods, "gt": {"truth_rmse_xyz_m": _gt_error(test.trajectories)}}


def known(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested numbers rounded to 4 digits, without those that are not known."""
    rounded = {key: text_table.rounded(value) for key, value in numbers.items()}
    kept = {key: known(value) if isinstance(value, dict) else value for key, value in rounded.items()}
    return {key: value for key, value in kept.items() if value is not None and value != {}}


def _errors(rows: pd.DataFrame, rng: np.random.Generator) -> dict[str, Any]:
    means = {name: float(rows[name].mean()) for name in ERRORS}  # NaN where every repetition is
    if len(rows) < 2:
        return means
    return {**means, "rmse_xyz_ci95_m": list(metrics.mean_ci95(rows["rmse_xyz_m"].to_numpy(), rng))}


def _gt_error(trajectories: pd.DataFrame) -> float | None:
    found = {
        which: rows.sort_values("submap")[["x_m", "y_m", "z_m"]].to_numpy()
        for which, rows in trajectories.groupby("which")
    }
    return metrics.rmse(found["gt"], found["truth"]) if {"gt", "truth"} <= set(found) else None


def _rng(settings: Settings, *names: str) -> np.random.Generator:
    # by name, so that an interval does not change when another method or survey joins
    return np.random.default_rng([settings.seed, *(zlib.crc32(name.encode()) for name in names)])
